"""Layouts that show a run at once: for Foxglove and for PlotJuggler, of the same plots."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

from lpvmpc.export.topics import place_of

if TYPE_CHECKING:
    from lpvmpc.sim.log import Log

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#E69F00")
PLOTS = {
    "lateral error [m]": ("ey_m", "est_ey_m"),
    "heading error [rad]": ("epsi_rad", "est_epsi_rad"),
    "speed [m/s]": ("vx_mps", "vx_ref_mps"),
    "steering [rad]": ("delta_rad", "delta_cmd_rad"),
    "acceleration [m/s2]": ("ax_mps2", "ax_cmd_mps2", "ay_mps2"),
    "tire forces to the left [N]": ("Fy_fl_N", "Fy_fr_N", "Fy_rl_N", "Fy_rr_N"),
}
"""Columns by plot; those that a run lacks are left out."""


def _plots(log: Log) -> dict[str, list[str]]:
    """The columns of each plot that the run has."""
    return {title: [name for name in names if name in log.columns]
            for title, names in PLOTS.items()}


def foxglove(log: Log) -> dict[str, Any]:
    """A layout to import into Foxglove: the plots on the right, the road and the car on the left.

    Args:
        log: The run that it will show.
    """
    panels: dict[str, Any] = {"3D!road": {
        "cameraState": {"perspective": True, "distance": 40.0, "phi": 55.0, "thetaOffset": 90.0,
                        "target": [0, 0, 0], "targetOffset": [0, 0, 0], "fovy": 45, "near": 0.5,
                        "far": 5000},
        "followMode": "follow-pose", "followTf": "car", "scene": {}, "layers": {},
        "topics": {"/scene": {"visible": True}},
    }}
    for number, (title, names) in enumerate(_plots(log).items()):
        places = [place_of(name) for name in names]
        panels[f"Plot!p{number}"] = {
            "title": title, "xAxisVal": "timestamp", "isSynced": True, "legendDisplay": "floating",
            "showLegend": True, "showPlotValuesInLegend": True, "showXAxisLabels": True,
            "showYAxisLabels": True, "sidebarDimension": 240, "foxglovePanelTitle": title,
            "paths": [{"value": f"{place.topic}.{place.field}", "enabled": True,
                       "timestampMethod": "receiveTime", "color": colour, "label": name}
                      for place, name, colour in zip(places, names, COLOURS, strict=False)],
        }
    first, *names = panels
    return {
        "configById": panels, "globalVariables": {}, "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {"direction": "row", "first": first, "second": _stack(names),
                   "splitPercentage": 45},
    }


def _stack(names: list[str]) -> Any:
    """Panels below each other, all of the same height."""
    if len(names) == 1:
        return names[0]
    return {"direction": "column", "first": names[0], "second": _stack(names[1:]),
            "splitPercentage": 100.0 / len(names)}


def plotjuggler(log: Log, *, topics: bool) -> str:
    """A layout to load into PlotJuggler, after the trace.

    Args:
        log: The run that it will show.
        topics: Whether the trace is read from topics (MCAP), or is a table of columns (CSV).
    """
    plots = _plots(log)
    areas = []
    for title, names in plots.items():
        curves = "".join(
            f"<curve name={quoteattr(_curve(name, topics))} color={quoteattr(colour)}/>"
            for name, colour in zip(names, COLOURS, strict=False))
        areas.append(f"     <DockArea name={quoteattr(title)}>\n"
                     '      <plot mode="TimeSeries" style="Lines" flip_x="false" flip_y="false">'
                     f"{curves}</plot>\n     </DockArea>")
    share = ";".join([f"{1.0 / len(plots):.6f}"] * len(plots))
    return "\n".join((
        "<?xml version='1.0' encoding='UTF-8'?>",
        "<root>",
        ' <tabbed_widget name="Main Window" parent="main_window">',
        '  <Tab tab_name="run" containers="1">',
        "   <Container>",
        f'    <DockSplitter orientation="-" count="{len(plots)}" sizes="{share}">',
        *areas,
        "    </DockSplitter>",
        "   </Container>",
        "  </Tab>",
        '  <currentTabIndex index="0"/>',
        " </tabbed_widget>",
        ' <use_relative_time_offset enabled="0"/>',
        "</root>", ""))


def _curve(column: str, topics: bool) -> str:
    """What PlotJuggler calls a column."""
    if not topics:
        return column
    place = place_of(column)
    return f"{place.topic}/{place.field}"
