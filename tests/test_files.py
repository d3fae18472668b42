import os

import pytest

from lpvmpc.errors import DataError, OutputError
from lpvmpc.kit import files
from lpvmpc.kit.files import into, whole


def test_a_file_appears_when_it_is_whole(tmp_path):
    file = tmp_path / "a.txt"
    file.write_text("old")
    with whole(file) as part:
        part.write_text("new")
        assert file.read_text() == "old" and part.parent == tmp_path
    assert file.read_text() == "new"
    assert list(tmp_path.iterdir()) == [file]


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, DataError])
def test_what_was_begun_is_removed_and_the_old_file_kept(tmp_path, error):
    file = tmp_path / "a.txt"
    file.write_text("old")
    with pytest.raises(error), whole(file) as part:
        part.write_text("half")
        raise error
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]


def test_a_place_that_cannot_be_written_is_one_sentence_with_the_file_s_own_name(tmp_path):
    file = tmp_path / "none" / "a.txt"
    with pytest.raises(OutputError) as caught, whole(file) as part:
        part.write_text("x")
    assert str(caught.value) == f"Cannot write {str(file)!r}: No such file or directory."
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match=r"^Cannot write into '.*file/below': Not a directory"):
        with into(tmp_path / "file" / "below"):
            pass


def test_a_folder_is_made_and_its_files_tell_their_own_errors(tmp_path):
    with pytest.raises(OutputError, match=r"Cannot write '.*a\.txt'"):
        with into(tmp_path / "new" / "folder") as folder, whole(folder / "no" / "a.txt") as part:
            part.write_text("x")
    assert (tmp_path / "new" / "folder").is_dir()


# Reading ----------------------------------------------------------------------------------------


def test_only_ordinary_files_of_a_sensible_size_are_read(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "large").write_bytes(bytes(1001))
    for name, why in (
        (tmp_path / "pipe", "it is a pipe"), ("/dev/zero", "it is a device"),
        (tmp_path, "it is a directory"), (tmp_path / "large", "larger than"),
        (tmp_path / "none", "No such file"), ("x" * 5000, "name too long"), ("a\0b", "no file can"),
    ):
        with pytest.raises(OSError) as error:
            files.read_bytes(name, 1000)
        assert why in error.value.strerror
    assert files.read_bytes(tmp_path / "large", 1001) == bytes(1001)


@pytest.mark.parametrize(
    "text",
    ["a = " + "[" * 100_000, "a = " + "[" * 30 + "]" * 30, "a." * 30 + "a = 1",
     "a." * 400_000 + "a = 1", "a = " + "9" * 5000, "a = 0x" + "f" * 5000, "a = 1\na = 2",
     "a = \xff"],
)
def test_settings_that_cannot_even_be_printed_are_refused(tmp_path, text):
    (tmp_path / "a.toml").write_text(text, encoding="latin-1")
    with pytest.raises(ValueError):
        files.read_toml(tmp_path / "a.toml")


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"a":' * 30 + "1" + "}" * 30, "1" * 5000, "{", ""]
)
def test_json_is_held_to_the_same(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(ValueError):
        files.read_json(tmp_path / "a.json")
