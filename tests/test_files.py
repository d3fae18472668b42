import pytest

from lpvmpc.errors import DataError, OutputError
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
