"""A run as MCAP, the format of Foxglove and PlotJuggler: topics of JSON messages with schemas.

Every column of the trace is a field of a topic (`topics.place_of` says which). `/timing` has the
controller's times; `/tf` and `/scene` hold what Foxglove's 3D panel draws: the car, its prediction
and the edges of the road. The run's metrics.json is an attachment.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from lpvmpc.export.topics import Place, places_of
from lpvmpc.kit.files import whole

if TYPE_CHECKING:
    from mcap.writer import Writer

    from lpvmpc.sim.log import Log

NUMBER = {"type": ["number", "null"]}
ANY = {"type": "object"}
SHAPE = (4.1, 1.8, 1.5)
"""Length, width and height of the box that stands for the car [m]."""
EDGE = 2.0
"""Distance of the points of the road's edges [m]."""


def write_mcap(log: Log, content: Mapping[str, Any], file: Path) -> None:
    """Write the file: one message a topic and control instant, at the time of that instant.

    Args:
        log: The run.
        content: What metrics.json holds of it.
        file: File to write, .mcap.

    Raises:
        OutputError: The file cannot be written.
    """
    from mcap.writer import CompressionType, Writer

    text = json.dumps(content, indent=2).encode()
    with whole(file) as part, part.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="", library=f"lpvmpc {content['versions']['lpvmpc']}")
        writer.add_metadata("run", {key: str(content[key]) for key in (
            "scenario", "controller", "seed", "completed", "model_sha256")})
        writer.add_attachment(0, 0, "metrics.json", "application/json", text)
        _columns(writer, log.columns, places_of(log.columns))
        _columns(writer, log.timing, {name: Place("/timing", name) for name in log.timing})
        _scene(writer, log)
        writer.finish()


def nanoseconds(t_s: float) -> int:
    """A time as MCAP counts it."""
    return round(1e9 * t_s)


def _columns(writer: Writer, columns: Mapping[str, npt.NDArray[Any]],
             places: Mapping[str, Place]) -> None:
    """The topics of columns: a message for each row."""
    topics: dict[str, dict[str, list[str]]] = {}
    for name, place in places.items():
        topics.setdefault(place.topic, {}).setdefault(place.field, []).append(name)
    times = [nanoseconds(t) for t in columns["t_s"].tolist()]
    for topic, fields in topics.items():
        values = {field: _values(columns, sorted(names, key=lambda name: places[name].index or 0),
                                 places[names[0]].index is not None)
                  for field, names in fields.items()}
        kinds = {field: _schema(column) for field, column in values.items()}
        channel = _channel(writer, topic, f"lpvmpc{topic.replace('/', '.')}", {
            "type": "object", "properties": kinds})
        for k, time in enumerate(times):
            _send(writer, channel, time, {field: column[k] for field, column in values.items()})


def _values(columns: Mapping[str, npt.NDArray[Any]], names: list[str], listed: bool) -> list[Any]:
    """What a field is in each row: the value of its column, or a list of those of several."""
    if listed:
        rows = np.stack([columns[name] for name in names], axis=1).tolist()
        return [[_known(value) for value in row] for row in rows]
    return [_known(value) for value in columns[names[0]].tolist()]


def _known(value: Any) -> Any:
    """A value that JSON can hold: null for a number that is not finite."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _schema(values: list[Any]) -> dict[str, Any]:
    """JSON schema of a field."""
    first = values[0] if values else 0.0
    if isinstance(first, list):
        return {"type": "array", "items": NUMBER}
    return {"type": "boolean"} if isinstance(first, bool) else dict(NUMBER)


def _channel(writer: Writer, topic: str, name: str, schema: Mapping[str, Any]) -> int:
    """A new topic, and its number."""
    number = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
    return int(writer.register_channel(topic, "json", number))


def _send(writer: Writer, channel: int, time: int, message: Mapping[str, Any]) -> None:
    """A message at a time [ns]."""
    text = json.dumps(message, separators=(",", ":"), allow_nan=False).encode()
    writer.add_message(channel, log_time=time, data=text, publish_time=time)


# The 3D panel -------------------------------------------------------------------------------------


def _scene(writer: Writer, log: Log) -> None:
    """The road's edges once, and in every row the car's place and its prediction."""
    scene = _channel(writer, "/scene", "foxglove.SceneUpdate", {"type": "object", "properties": {
        "deletions": {"type": "array", "items": ANY}, "entities": {"type": "array", "items": ANY}}})
    tf = _channel(writer, "/tf", "foxglove.FrameTransform", {"type": "object", "properties": {
        "timestamp": ANY, "parent_frame_id": {"type": "string"},
        "child_frame_id": {"type": "string"}, "translation": ANY, "rotation": ANY}})
    c = log.columns
    for k, t in enumerate(c["t_s"].tolist()):
        time = nanoseconds(t)
        stamp = {"sec": time // 10**9, "nsec": time % 10**9}
        x, y, psi = (float(c[name][k]) for name in ("x_m", "y_m", "psi_rad"))
        if not math.isfinite(x + y + psi):
            continue
        _send(writer, tf, time, {
            "timestamp": stamp, "parent_frame_id": "world", "child_frame_id": "car",
            "translation": {"x": x, "y": y, "z": 0.0},
            "rotation": {"x": 0.0, "y": 0.0, "z": math.sin(psi / 2), "w": math.cos(psi / 2)}})
        entities = [_lines("prediction", "world", stamp, _prediction(c, k), (0.9, 0.6, 0.0), 0.3)]
        if k == 0:
            entities += [_lines(name, "world", stamp, points, (0.5, 0.5, 0.5), 0.15)
                         for name, points in _edges(log.scenario.path)]
            entities.append(_box(stamp))
        _send(writer, scene, time, {"deletions": [], "entities": entities})


def _prediction(c: Mapping[str, npt.NDArray[Any]], row: int) -> list[tuple[float, float]]:
    """Points of the predicted path; none where it begins too far from the car to be its own.

    A told delay puts its start up to a second ahead.
    """
    count = sum(name.startswith("pred_x_m_") for name in c)
    points = ((float(c[f"pred_x_m_{k}"][row]), float(c[f"pred_y_m_{k}"][row]))
              for k in range(count))
    known = [point for point in points if math.isfinite(sum(point))]
    place = (float(c["x_m"][row]), float(c["y_m"][row]))
    near = bool(known) and math.dist(known[0], place) < float(c["vx_mps"][row]) + 3.0
    return known if near else []


def _edges(path: Any) -> Iterator[tuple[str, list[tuple[float, float]]]]:
    """Points of the road's edges."""
    s = np.linspace(0.0, path.length, max(2, math.ceil(path.length / EDGE)))
    x, y, psi, _ = path.at(s)
    for name, width in (("left", path.width_left), ("right", -path.width_right)):
        side = np.interp(s, path.s, width)
        yield name, list(zip((x - side * np.sin(psi)).tolist(), (y + side * np.cos(psi)).tolist(),
                             strict=True))


def _entity(name: str, frame: str, stamp: Mapping[str, int], **shapes: Any) -> dict[str, Any]:
    """Something to draw, which stays until one of the same name comes."""
    return {"timestamp": stamp, "frame_id": frame, "id": name, "frame_locked": True,
            "lifetime": {"sec": 0, "nsec": 0}, "metadata": [], **shapes}


def _pose(x: float = 0.0, z: float = 0.0) -> dict[str, Any]:
    return {"position": {"x": x, "y": 0.0, "z": z},
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}


def _lines(name: str, frame: str, stamp: Mapping[str, int], points: list[tuple[float, float]],
           colour: tuple[float, float, float], thickness: float) -> dict[str, Any]:
    """A line through points on the road."""
    r, g, b = colour
    return _entity(name, frame, stamp, lines=[{
        "type": 0, "pose": _pose(), "thickness": thickness, "scale_invariant": False,
        "points": [{"x": x, "y": y, "z": 0.02} for x, y in points],
        "color": {"r": r, "g": g, "b": b, "a": 1.0}, "colors": [], "indices": []}])


def _box(stamp: Mapping[str, int]) -> dict[str, Any]:
    """The car, as a box that moves with its frame."""
    return _entity("car", "car", stamp, cubes=[{
        "pose": _pose(z=0.5 * SHAPE[2]), "size": dict(zip("xyz", SHAPE, strict=True)),
        "color": {"r": 0.0, "g": 0.45, "b": 0.7, "a": 0.8}}])
