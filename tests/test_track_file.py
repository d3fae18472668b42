import numpy as np
import pytest

from lpvmpc.errors import PathError
from lpvmpc.road import track_file


def write(folder, text):
    file = folder / "road.csv"
    file.write_text(text)
    return file


HEADER = "# x_m,y_m,w_tr_right_m,w_tr_left_m,vx_mps,wind_mps\n"


def test_all_columns_are_read_by_name(tmp_path):
    track = track_file.read_csv(write(tmp_path, "# wind_mps, y_m, x_m\n5,2,1\n6,4,3\n"))
    np.testing.assert_array_equal(track.xy, [[1.0, 2.0], [3.0, 4.0]])
    np.testing.assert_array_equal(track.wind, [5.0, 6.0])
    assert track.width_left is None and track.vx is None
    full = track_file.read_csv(
        write(tmp_path, HEADER + "1,2,3,4,5,6\n\n# a comment\n1,2,3,4,5,6\n")
    )
    assert (full.width_right[0], full.width_left[0], full.vx[0], full.wind[1]) == (3, 4, 5, 6)


def test_a_header_may_lack_its_hash_or_be_missing(tmp_path):
    for text in ("x_m,y_m\n1,2\n3,4\n", "1,2\n3,4\n", "\ufeff# x_m,y_m\r\n1,2\r\n3,4\r\n"):
        np.testing.assert_array_equal(
            track_file.read_csv(write(tmp_path, text)).xy, [[1.0, 2.0], [3.0, 4.0]]
        )


@pytest.mark.parametrize("mark", [",", ";", "\t", "; "])
def test_columns_may_be_parted_by_commas_semicolons_or_tabs(tmp_path, mark):
    rows = [("# x_m", "y_m", "vx_mps"), ("1", "2", "9"), ("3", "4", "8")]
    text = "# made by a tool, version 1\n" + "\n".join(mark.join(row) for row in rows)
    track = track_file.read_csv(write(tmp_path, text))
    np.testing.assert_array_equal(track.xy, [[1.0, 2.0], [3.0, 4.0]])
    np.testing.assert_array_equal(track.vx, [9.0, 8.0])
    assert track.lines == (3, 4)


def test_a_race_line_is_read(tmp_path):
    text = (
        "# made by a lap time tool\n# 1234-abcd\n"
        "# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2\n"
        "0.0; 0.0; 5.0; -1.57; 0.0; 12.0; 0.1\n3.2; 3.2; 5.0; -1.57; 0.0; 12.5; 0.1\n"
    )
    track = track_file.read_csv(write(tmp_path, text))
    np.testing.assert_array_equal(track.xy, [[0.0, 5.0], [3.2, 5.0]])
    np.testing.assert_array_equal(track.vx, [12.0, 12.5])
    assert track.width_left is None


def test_short_names_are_read(tmp_path):
    track = track_file.read_csv(write(tmp_path, "x,y,width_right,width_left\n1,2,5,6\n3,4,5,6\n"))
    np.testing.assert_array_equal(track.xy, [[1.0, 2.0], [3.0, 4.0]])
    assert (track.width_right[0], track.width_left[1]) == (5.0, 6.0)


def test_a_car_may_stand_at_both_ends(tmp_path):
    track = track_file.read_csv(write(tmp_path, "x_m,y_m,vx_mps\n1,2,0\n3,4,2\n5,6,0\n"))
    np.testing.assert_array_equal(track.vx, [0.0, 2.0, 0.0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no points"),
        (HEADER, "holds no points"),
        ("# x_m\n1\n2\n", "one column"),
        ("# x_m,y_m\n1,2\n3,four\n", "Line 3 .* 'four', which is not a number"),
        ("# x_m,y_m\n1,2\n3,\n", "not a number"),
        ("# x_m,y_m\n1,2\n1_0,4\n", "Line 3 .* '1_0', which is not a number"),
        ("# x_m,y_m\n1,2\n3,nan\n", "Line 3 .* NaN or infinity"),
        ("# x_m,y_m\n1,inf\n", "NaN or infinity"),
        ("# x_m,y_m\n1,2\n3,4,5\n", "Line 3 .* 3 columns"),
        ("# x_m,y_m,w_tr_right_m\n1,2\n", "2 columns of numbers, but its header"),
        ("# x_m,y_m,y_m\n1,2,3\n", "name each column once"),
        ("# x_m,z_m\n1,2\n", "x_m and y_m among them"),
        (HEADER + "1,2,-3,4,5,6\n", "w_tr_right_m"),
        (HEADER + "1,2,3,4,5,6\n1,2,3,4,0,6\n1,2,3,4,5,6\n",
         r"vx_mps is 0 in row 2 \(line 3\) .* from 0.1 to 60 m/s, or 0 in the first and the last"),
        (HEADER + "1,2,3,4,61,6\n", r"vx_mps is 61 in row 1 \(line 2\)"),
        ("0,0,0\n3,3,0\n", "3 columns of numbers and no header that names them"),
        ("# x_m;y_m\n1,5;2\n", "Line 2 .* '1,5', which is not a number"),
        (HEADER + "1,2,3,4,5,600\n", "wind_mps"),
    ],
)
def test_a_file_that_is_no_track_is_refused_in_one_sentence(tmp_path, text, message):
    with pytest.raises(PathError, match=message) as error:
        track_file.read_csv(write(tmp_path, text))
    assert "road.csv" in str(error.value) and "\n" not in str(error.value)


def test_what_is_no_file_is_refused(tmp_path):
    with pytest.raises(PathError, match="does not exist"):
        track_file.read_csv(tmp_path / "none.csv")
    with pytest.raises(PathError, match="it is a directory, not a file"):
        track_file.read_csv(tmp_path)
    (tmp_path / "binary.csv").write_bytes(bytes(range(128, 256)))
    with pytest.raises(PathError, match="not a text file"):
        track_file.read_csv(tmp_path / "binary.csv")
