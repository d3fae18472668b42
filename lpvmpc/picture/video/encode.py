"""Video files: encoding pictures so that a browser plays them, and the README's moving picture."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from lpvmpc.errors import DataError, OptionError, OutputError, RenderError
from lpvmpc.kit.files import into, whole, writing

if TYPE_CHECKING:
    import av.container
    import av.video.stream

Image = npt.NDArray[np.uint8]


class Encoder:
    """A video file that appears under its name when it is closed, and always plays.

    Pictures are encoded in a thread of its own, beside the drawing of the next.
    """

    def __init__(self, path: FilePath, width: int, height: int, fps: int) -> None:
        """Args: the file to write, the size of the pictures [px], frames per second."""
        self.path = path
        self.part = path.with_name(f".{path.name}.{os.getpid()}.part")
        self.size, self.fps = (width, height), fps
        self.frames = 0
        self.failure: Exception | None = None
        # Two pictures may wait: enough for a pause of either side, and little memory.
        self.waiting: queue.Queue[Image | None] = queue.Queue(maxsize=2)
        self.worker = threading.Thread(target=self._work, name="encoder", daemon=True)

    def __enter__(self) -> Encoder:
        import av

        av.logging.set_level(av.logging.ERROR)
        with writing(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.container: av.container.OutputContainer = av.open(
                str(self.part), "w", format="mp4", options={"movflags": "+faststart"})
        self.stream = _stream(self.container, self.fps)
        self.stream.width, self.stream.height = self.size
        self.stream.pix_fmt = "yuv420p"
        # OpenCV's conversion is that of BT.601 with studio range; say so to the player.
        self.stream.codec_context.colorspace = 6
        self.stream.codec_context.color_range = 1
        self.worker.start()
        return self

    def add(self, frame: Image) -> None:
        """Append one RGB picture, which must not be changed afterwards."""
        self._check()
        self.waiting.put(frame)
        self.frames += 1

    def _work(self) -> None:
        """Encode what waits, until None comes; after a failure only empty the queue."""
        import av

        while (frame := self.waiting.get()) is not None:
            if self.failure is not None:
                continue
            try:
                # OpenCV converts in a fifth of swscale's time.
                planes = cv2.cvtColor(frame, cv2.COLOR_RGB2YUV_I420)
                picture = av.VideoFrame.from_ndarray(planes, format="yuv420p")
                self.container.mux(self.stream.encode(picture))
            except Exception as error:  # told to the thread that adds pictures
                self.failure = error

    def _check(self) -> None:
        """Raise what went wrong in the worker."""
        if isinstance(self.failure, OSError):  # FFmpeg's errors are of this kind, too
            raise OutputError(f"Cannot write {str(self.path)!r}: {self.failure}.") from self.failure
        if self.failure is not None:
            raise self.failure

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: object) -> None:
        """Finish the file; keep it unless something other than Ctrl-C went wrong."""
        self.waiting.put(None)
        self.worker.join()
        keep = self.frames > 0 and (kind is None or issubclass(kind, KeyboardInterrupt))
        try:
            if keep and self.failure is None:
                self.container.mux(self.stream.encode())
            self.container.close()
            if keep and self.failure is None:
                os.replace(self.part, self.path)
        except OSError as broken:
            self.failure = self.failure or broken
        finally:
            self.part.unlink(missing_ok=True)
        if kind is None:
            self._check()


def _stream(container: Any, fps: int) -> Any:
    """Video stream of the best encoder that this PyAV has."""
    import av

    for codec, options in (("libx264", {"preset": "veryfast", "crf": "25"}),
                           ("libvpx-vp9", {"deadline": "realtime", "cpu-used": "8", "crf": "34",
                                           "b": "0", "row-mt": "1"})):
        try:
            av.codec.Codec(codec, "w")
        except ValueError:  # UnknownCodecError
            continue
        return container.add_stream(codec, rate=fps, options=options)
    raise RenderError("PyAV has neither libx264 nor libvpx-vp9; reinstall it: pip install av.")


def moving_picture(video: str | FilePath, path: str | FilePath, *, start: float = 0.0,
                   seconds: float = 6.0, width: int = 600, fps: int = 10,
                   limit: int = 1_500_000) -> FilePath:
    """Cut an endless animated WebP out of a video, small enough for a README.

    The quality is lowered until the file is below the limit.

    Args:
        video: File of `render_video`.
        path: File to write, .webp.
        start: Where the cut begins [s].
        seconds: How long it is [s].
        width: Width of the picture [px], even.
        fps: Pictures per second.
        limit: Largest size of the file [byte].

    Returns:
        The file written.

    Raises:
        DataError: The video is missing, damaged or ends before `start`.
        OptionError: No quality makes the file small enough.
        OutputError: The file cannot be written.
    """
    path = FilePath(path)
    pictures = list(_cut(FilePath(video), start, seconds, width, fps))
    if not pictures:
        raise DataError(f"{str(video)!r} has no pictures from {start:g} s on.")
    with into(path.parent), whole(path) as part:
        for quality in range(80, 0, -10):
            _write_webp(part, pictures, fps, quality)
            if part.stat().st_size <= limit:
                break
        else:
            raise OptionError("limit", limit, "more bytes than the lowest quality needs")
    return path


def _cut(video: FilePath, start: float, seconds: float, width: int, fps: int) -> Iterator[Any]:
    """Pictures of a part of a video, scaled and thinned to `fps`."""
    import av

    try:
        with av.open(str(video)) as container:
            due = start
            for frame in container.decode(video=0):
                if frame.time is None or frame.time < due - 1e-6:
                    continue
                if frame.time >= start + seconds - 1e-6:
                    break
                due += 1.0 / fps
                height = round(width * frame.height / frame.width / 2.0) * 2
                yield frame.reformat(width, height, format="yuv420p", interpolation="AREA")
    except (OSError, av.FFmpegError) as error:
        raise DataError(f"Cannot read the video {str(video)!r}: {error}.") from error


def _write_webp(path: FilePath, pictures: list[Any], fps: int, quality: int) -> None:
    """Write an animated WebP that starts again for ever."""
    import av

    with av.open(str(path), "w", format="webp", options={"loop": "0"}) as container:
        stream = container.add_stream("libwebp_anim", rate=fps, options={
            "quality": str(quality), "compression_level": "4"})
        stream.width, stream.height = pictures[0].width, pictures[0].height
        stream.pix_fmt = "yuv420p"
        for number, picture in enumerate(pictures):
            picture.pts, picture.time_base = number, Fraction(1, fps)
            container.mux(stream.encode(picture))
        container.mux(stream.encode())


def smaller(video: str | FilePath, path: str | FilePath, width: int) -> FilePath:
    """A copy of a video with smaller pictures, for a page.

    Args:
        video: File of `render_video`.
        path: File to write, .mp4.
        width: Width of its pictures [px], even.

    Returns:
        The file written.

    Raises:
        DataError: The video is missing or damaged.
        OutputError: The file cannot be written.
    """
    import av

    try:
        with av.open(str(video)) as source:
            picture = source.streams.video[0]
            fps = round(picture.average_rate or 30)
            height = round(width * picture.height / picture.width / 2.0) * 2
            with Encoder(FilePath(path), width, height, fps) as copy:
                for frame in source.decode(picture):
                    copy.add(frame.reformat(width, height, "rgb24", interpolation="AREA")
                             .to_ndarray())
    except (OSError, IndexError, av.FFmpegError) as error:
        if isinstance(error, OutputError):
            raise
        raise DataError(f"Cannot read the video {str(video)!r}: {error}.") from error
    return FilePath(path)
