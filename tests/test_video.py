import os
import struct

import av
import numpy as np
import pytest

from lpvmpc.errors import DataError, OptionError, OutputError
from lpvmpc.picture.video import encode


def picture(k, width=96, height=64):
    """A bright bar that moves to the right."""
    frame = np.full((height, width, 3), 40, np.uint8)
    frame[:, 2 * k % width : 2 * k % width + 8] = 220
    return frame


@pytest.fixture
def film(tmp_path):
    """Two seconds at 30 frames per second."""
    file = tmp_path / "film.mp4"
    with encode.Encoder(file, 96, 64, 30) as encoder:
        for k in range(60):
            encoder.add(picture(k))
    return file


def decode(file):
    with av.open(str(file)) as container:
        stream = container.streams.video[0]
        pictures = [f.to_ndarray(format="rgb24") for f in container.decode(stream)]
        return pictures, stream.codec_context.name, float(stream.average_rate)


def webp_frames(data):
    """Durations [ms] of the pictures of an animated WebP, and how often it repeats."""
    at, durations, loops = 12, [], None
    while at < len(data):
        name, size = data[at : at + 4], struct.unpack("<I", data[at + 4 : at + 8])[0]
        body = data[at + 8 : at + 8 + size]
        if name == b"ANIM":
            loops = struct.unpack("<H", body[4:6])[0]
        elif name == b"ANMF":
            durations.append(int.from_bytes(body[12:15], "little"))
        at += 8 + size + size % 2
    return durations, loops


def test_pictures_come_back_in_order_and_at_their_rate(film):
    pictures, codec, rate = decode(film)
    assert codec == "h264" and rate == 30.0 and len(pictures) == 60
    for k in (0, 20, 40):
        centre = np.argmax(pictures[k].mean(axis=(0, 2)))
        assert abs(centre - 2 * k - 4) <= 5  # the bar is 8 px wide


def test_colours_survive_the_video(tmp_path):
    shades = np.array(((200, 40, 40), (40, 180, 60), (30, 60, 200), (128, 128, 128)), np.uint8)
    frame = np.repeat(np.repeat(shades.reshape(2, 2, 3), 32, axis=0), 32, axis=1)
    with encode.Encoder(tmp_path / "film.mp4", 64, 64, 30) as encoder:
        encoder.add(frame)
    back = decode(tmp_path / "film.mp4")[0][0].astype(int)
    for row, column in ((16, 16), (16, 48), (48, 16), (48, 48)):  # centres of the patches
        # 8-bit conversion there and back, and the encoder's own loss
        assert np.abs(back[row, column] - frame[row, column]).max() <= 8


def test_vp9_takes_over_where_there_is_no_h264(tmp_path, monkeypatch):
    real = av.codec.Codec

    def without_x264(name, mode):
        if name == "libx264":
            raise ValueError(name)
        return real(name, mode)

    monkeypatch.setattr(av.codec, "Codec", without_x264)
    with encode.Encoder(tmp_path / "film.mp4", 96, 64, 30) as encoder:
        for k in range(10):
            encoder.add(picture(k))
    pictures, codec, _ = decode(tmp_path / "film.mp4")
    assert codec == "vp9" and len(pictures) == 10


def test_a_file_without_pictures_is_not_kept(tmp_path):
    with encode.Encoder(tmp_path / "film.mp4", 96, 64, 30):
        pass
    assert not list(tmp_path.iterdir())


def test_a_full_disk_is_told_and_leaves_nothing(tmp_path):
    with pytest.raises(OutputError, match="No space left"):
        with encode.Encoder(tmp_path / "film.mp4", 96, 64, 30) as encoder:
            encoder.container = FullDisk(encoder.container)
            for k in range(60):
                encoder.add(picture(k))
    assert not list(tmp_path.iterdir())


class FullDisk:
    """A container whose file cannot grow."""

    def __init__(self, container):
        self.close = container.close

    def mux(self, packets):
        raise OSError(28, "No space left on device")


def test_the_name_appears_only_when_the_file_is_whole(tmp_path):
    with encode.Encoder(tmp_path / "film.mp4", 96, 64, 30) as encoder:
        encoder.add(picture(0))
        assert not (tmp_path / "film.mp4").exists()
    assert os.listdir(tmp_path) == ["film.mp4"]


def test_the_moving_picture_repeats_for_ever_and_is_small(film, tmp_path):
    file = encode.moving_picture(film, tmp_path / "readme" / "film.webp", start=0.5, seconds=1.0,
                                width=48, fps=10, limit=20_000)
    data = file.read_bytes()
    assert data[:4] == b"RIFF" and data[8:12] == b"WEBP"
    durations, loops = webp_frames(data)
    assert loops == 0  # for ever
    assert sum(durations) == pytest.approx(1000, abs=100)  # ms; equal pictures may be merged
    assert len(data) <= 20_000 and os.listdir(file.parent) == ["film.webp"]


def test_a_limit_that_no_quality_meets_is_refused(film, tmp_path):
    with pytest.raises(OptionError, match="limit is 100"):
        encode.moving_picture(film, tmp_path / "film.webp", limit=100)
    assert not (tmp_path / "film.webp").exists()


@pytest.mark.parametrize("start", [0.0, 50.0])
def test_a_missing_or_short_video_is_named(start, film, tmp_path):
    file = film if start else tmp_path / "none.mp4"
    with pytest.raises(DataError, match=file.name):
        encode.moving_picture(file, tmp_path / "x.webp", start=start)


def test_a_damaged_video_is_named(tmp_path):
    (tmp_path / "bad.mp4").write_bytes(b"not a video" * 100)
    with pytest.raises(DataError, match="bad.mp4"):
        encode.moving_picture(tmp_path / "bad.mp4", tmp_path / "x.webp")


def test_a_folder_that_cannot_be_written_is_named(film, tmp_path):
    with pytest.raises(OutputError, match="film.mp4"):
        encode.moving_picture(film, film / "x.webp")
