"""Files that are wrong, by what they are given to: contents as bytes, one fault each."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

_ROAD = "\n".join(f"{x},0,4,4,10" for x in range(0, 200, 2))
_HEADER = "# x_m,y_m,w_tr_right_m,w_tr_left_m,vx_mps\n"


def _row(i: int, text: str) -> str:
    """The good road with another row i."""
    rows = _ROAD.splitlines()
    rows[i] = text
    return _HEADER + "\n".join(rows)


ROADS: dict[str, str | bytes] = {
    "empty": "",
    "header-only": _HEADER,
    "blank-lines": "\n\n\n",
    "only-comments": "# a\n# b\n",
    "one-column": "# x_m\n1\n2\n",
    "three-columns": "0,0,0\n3,3,0\n6,6,0\n",
    "no-y": "# x_m,z_m\n1,2\n3,4\n",
    "twice-named": "# x_m,y_m,y_m\n1,2,3\n",
    "header-short": "# x_m,y_m\n1,2,3\n1,2,4\n",
    "header-long": "# x_m,y_m,vx_mps\n1,2\n3,4\n",
    "a-word": _row(5, "10,zero,4,4,10"),
    "empty-cell": _row(5, "10,,4,4,10"),
    "nan": _row(5, "10,nan,4,4,10"),
    "infinite": _row(5, "10,inf,4,4,10"),
    "overflow": _row(5, "10,1e999,4,4,10"),
    "hexadecimal": _row(5, "0x10,0,4,4,10"),
    "too-many-columns": _row(5, "10,0,4,4,10,7"),
    "too-few-columns": _row(5, "10,0,4,4"),
    "underscore": _row(5, "1_0,0,4,4,10"),
    "other-digits": _row(5, "\u0661\u0660,0,4,4,10"),
    "quoted": _row(5, '"10",0,4,4,10'),
    "form-feed": _row(5, "10,0,\x0c,4,10"),
    "zero-byte": _row(5, "1\x000,0,4,4,10"),
    "latin-1": (_HEADER + _ROAD + "\n# ").encode() + b"\xe4\n",
    "one-far-away": _row(5, "1e308,0,4,4,10"),
    "endless-number": _HEADER + "1" * 10_000_000,
    "speed-twice": "# x_m,y_m,vx_mps,vx_mps\n" + "\n".join(f"{x},0,9,9" for x in range(0, 60, 2)),
    "race-line-backwards": "s_m; x_m; y_m; vx_mps\n" + "\n".join(
        f"{x}; {x}; 0; -3" for x in range(0, 60, 2)),
    "decimal-comma": "# x_m;y_m\n" + "\n".join(f"{x},5;0,1" for x in range(20)),
    "negative-width": _row(5, "10,0,-4,4,10"),
    "wide": _row(5, "10,0,4,400,10"),
    "slow": _row(5, "10,0,4,4,0.01"),
    "standing": _row(5, "10,0,4,4,0"),
    "backwards": _row(5, "10,0,4,4,-10"),
    "fast": _row(5, "10,0,4,4,300"),
    "stormy": "# x_m,y_m,wind_mps\n" + "\n".join(f"{x},0,500" for x in range(0, 100, 2)),
    "one-point": "# x_m,y_m\n1,2\n",
    "two-points": "# x_m,y_m\n1,2\n3,4\n",
    "four-points": "# x_m,y_m\n0,0\n10,0\n20,0\n30,0\n",
    "same-points": "# x_m,y_m\n" + "1,2\n" * 20,
    "repeated-point": _row(5, _ROAD.splitlines()[4]),
    "short": "# x_m,y_m\n" + "\n".join(f"{x / 10},0" for x in range(20)),
    "endless-road": "# x_m,y_m\n" + "\n".join(f"{x * 1e5},0" for x in range(20)),
    "beyond-numbers": "# x_m,y_m\n" + "\n".join(f"{x}e300,0" for x in range(1, 20)),
    "there-and-back": "# x_m,y_m\n" + "\n".join(f"{x},0" for x in [*range(30), *range(28, 0, -1)]),
    "a-dot": "# x_m,y_m\n" + "\n".join(f"{x * 1e-9},0" for x in range(50)),
    "zigzag": "# x_m,y_m\n" + "\n".join(f"{x * 0.2},{(x % 2) * 40}" for x in range(60)),
    "tight": "# x_m,y_m,vx_mps\n" + "\n".join(
        f"{x},{y},5" for x, y in [*((x, 0) for x in range(20)), *((19, y) for y in range(1, 2)),
                                  *((x, 1) for x in range(18, 0, -1))]),
    "binary": bytes(range(128, 256)),
    "utf-16": "# x_m,y_m\n1,2\n".encode("utf-16"),
    "zero-bytes": b"\0" * 400,
    "a-picture": b"\x89PNG\r\n\x1a\n" + b"\0" * 64,
    "json": '{"x": [1, 2], "y": [3, 4]}',
    "html": "<html><body>404</body></html>",
    "long-word": _row(5, "1" * 100_000 + "x,0,4,4,10"),
    "long-line": "1," * 200_000 + "\n2,3\n",
    "long-header": "# x_m,y_m," + "a," * 50_000 + "\n1,2\n",
    "control-characters": _row(5, "\x1b[31m,0,4,4,10"),
    "markup": _row(5, "[/red],0,4,4,10"),
}
"""Track files."""

_W = 'controller = "stanley"\n[weights]\n'
WEIGHTS: dict[str, str | bytes] = {
    "empty": "",
    "no-toml": "weights = [",
    "json": '{"weights": 1}',
    "no-weights": 'controller = "stanley"\n',
    "no-controller": "[weights]\nk_e = 1.0\n",
    "another-controller": 'controller = "lpv-mpc"\n[weights]\nq_ey = 1.0\n',
    "a-number-for-a-name": "controller = 3\n[weights]\nk_e = 1.0\n",
    "weights-no-table": 'controller = "stanley"\nweights = 3\n',
    "weights-empty": _W,
    "weights-a-list": 'controller = "stanley"\nweights = [1, 2]\n',
    "a-word": _W + 'k_e = "much"\n',
    "true": _W + "k_e = true\n",
    "a-list": _W + "k_e = [1.0]\n",
    "a-table": _W + "k_e = {a = 1}\n",
    "a-date": _W + "k_e = 2020-01-01\n",
    "nan": _W + "k_e = nan\n",
    "infinite": _W + "k_e = inf\n",
    "negative": _W + "k_e = -1.0\n",
    "large": _W + "k_e = 1e300\n",
    "whole-and-large": _W + "k_e = " + "9" * 400 + "\n",
    "long-number": _W + "k_e = " + "9" * 100_000 + "\n",
    "hexadecimal": _W + "k_e = 0x" + "f" * 100_000 + "\n",
    "unknown-weight": _W + "k_x = 1.0\n",
    "unknown-part": 'colour = "red"\n' + _W + "k_e = 1.0\n",
    "another-checksum": f'sha256 = "{"0" * 64}"\n' + _W + "k_e = 1.0\n",
    "checksum-a-number": "sha256 = 5\n" + _W + "k_e = 1.0\n",
    "twice": _W + "k_e = 1.0\nk_e = 2.0\n",
    "deep": _W + "k_e = " + "[" * 100_000,
    "deep-but-whole": _W + "k_e = " + "[" * 50 + "]" * 50,
    "deep-key": _W + "k." * 100_000 + "e = 1.0",
    "binary": bytes(range(128, 256)),
    "zero-bytes": b"\0" * 100,
}
"""Weights files of the controller stanley."""

WORLDS: dict[str, str | bytes] = {
    "no-toml": "latency = [",
    "unknown-name": "gravity = 9.8\n",
    "unknown-base": 'base = "mars"\n',
    "base-a-number": "base = 3\n",
    "latency-a-word": 'latency = "long"\n',
    "latency-negative": "latency = -0.1\n",
    "latency-long": "latency = 5.0\n",
    "latency-reversed": "latency = [0.04, 0.0]\n",
    "latency-three": "latency = [0.0, 0.01, 0.02]\n",
    "latency-nan": "latency = nan\n",
    "latency-true": "latency = true\n",
    "latency-whole-and-large": "latency = " + "9" * 400 + "\n",
    "sensor-place": 'steering_sensor = "roof"\n',
    "patches-a-number": "patches = 3\n",
    "patches-short": "patches = [[1.0, 2.0]]\n",
    "patches-reversed": "patches = [[20.0, 10.0, 0.5]]\n",
    "patches-ice": "patches = [[10.0, 20.0, 0.0]]\n",
    "patches-words": 'patches = [["a", "b", "c"]]\n',
    "sensing-unknown": 'sensing = "radar"\n',
    "sensing-a-number": "sensing = 3\n",
    "sensing-no-such": "[sensing]\ntemperature = {std = 1.0}\n",
    "sensing-no-such-part": "[sensing]\nr = {colour = 1.0}\n",
    "sensing-negative": "[sensing]\nr = {std = -1.0}\n",
    "sensing-a-word": '[sensing]\nr = {std = "much"}\n',
    "sensing-channel-a-number": "[sensing]\nr = 3\n",
    "sensing-lane-a-table": "[sensing]\nlane = {std = 1.0}\n",
    "sensing-scale": "[sensing]\nscale = -1\n",
    "sensing-scale-word": '[sensing]\nscale = "x"\n',
    "sensing-nothing": "[sensing]\nr = {measured = false}\n",
    "sensing-latency": "[sensing]\nposition = {latency = [0.5, 0.1]}\n",
    "sensing-base": '[sensing]\nbase = "radar"\n',
    "sensing-dropout": "[sensing]\nposition = {dropout = 2.0}\n",
    "car-a-number": "car = 3\n",
    "car-unknown": "[car]\nwings = 2\n",
    "car-mass": "[car]\nload = 1e9\n",
    "car-negative": "[car]\nCf = -1.0\n",
    "car-zero": "[car]\nCf = 0.0\n",
    "car-a-word": '[car]\nCf = "soft"\n',
    "car-std": "[car]\nCf = {mean = 1.0, std = -0.1}\n",
    "car-half": "[car]\nCf = {mean = 1.0}\n",
    "road-a-list": "road = []\n",
    "road-unknown": "[road]\ncolour = 1\n",
    "road-ice": "[road]\nfriction = 0.0\n",
    "road-wall": "[road]\ngrade = 5.0\n",
    "road-wavelength": "[road]\nwavelength = [1.0, 2.0]\n",
    "air-unknown": "[air]\nrain = 1\n",
    "air-storm": "[air]\nside_wind = 400.0\n",
    "air-none": "[air]\ndensity = 0.0\n",
    "air-a-word": '[air]\ndensity = "thin"\n',
    "deep": "about = " + "[" * 100_000,
    "deep-but-whole": "[car]\nCf = " + "[" * 50 + "]" * 50,
    "deep-key": "a." * 100_000 + "b = 1",
    "hexadecimal": "latency = 0x" + "f" * 100_000 + "\n",
    "binary": bytes(range(128, 256)),
}
"""World files."""

WORLDS |= {
    "latency-twice": "latency = 0.0\nlatency = 0.01\n",
    "latency-a-date": "latency = 2020-01-01T00:00:00Z\n",
    "latency-a-time": "latency = [07:32:00, 0.1]\n",
    "car-twice": "[car]\nCf = 1.0\n[car]\nCr = 1.0\n",
    "car-std-wide": "[car]\nCf = {mean = 1.0, std = 50.0}\n",
    "car-mean-a-table": "[car]\nCf = {mean = {a = 1}, std = 0.1}\n",
    "base-itself": 'base = "worlds/base-itself.toml"\n',
    "base-a-list": 'base = ["rtk"]\n',
    "sensing-rate": "[sensing]\nposition = {rate = nan}\n",
    "sensing-rate-large": "[sensing]\nposition = {rate = 1e300}\n",
    "sensing-measured-a-word": '[sensing]\nr = {measured = "no"}\n',
    "sensing-always-lost": "[sensing]\nposition = {dropout = 1.0}\n",
    "patches-endless": "patches = [[0.0, inf, 0.5]]\n",
    "road-friction-infinite": "[road]\nfriction = [0.8, inf]\n",
    "road-friction-below-zero": "[road]\nfriction = [-0.0, 0.0]\n",
    "air-std-large": "[air]\nside_wind = {mean = 0, std = 1e308}\n",
    "air-dense": "[air]\ndensity = 1e300\n",
    "escape-in-a-name": '"\\u001b[31mlatency" = 1\n',
    "a-pickle": b"\x80\x04\x95\x0b\0\0\0\0\0\0\0\x8c\x02os\x94.",
}

_USER = '[[user]]\nname = "x"\ns = 30\nspeed = 3\n'
TRAFFIC: dict[str, str | bytes] = {
    "empty": "",
    "a-number": "user = 3\n",
    "one-table": '[user]\nname = "x"\n',
    "no-place": '[[user]]\nname = "x"\nspeed = 3\n',
    "nowhere": _USER.replace("30", "nan"),
    "far-away": _USER.replace("30", "1e9"),
    "on-the-car": _USER.replace("30", "0"),
    "backwards": _USER.replace("= 3\n", "= -3\n"),
    "speed-a-word": _USER.replace("= 3\n", '= "fast"\n'),
    "speed-empty": _USER.replace("= 3\n", "= []\n"),
    "time-backwards": _USER.replace("= 3\n", "= [[5, 1], [0, 1]]\n"),
    "no-length": _USER + "length = 0\n",
    "wide": _USER + "width = 1e9\n",
    "side": _USER + 'side = "up"\n',
    "unknown": _USER + 'colour = "red"\n',
    "name-a-number": _USER.replace('"x"', "3"),
    "name-obeyed": _USER.replace('"x"', '"\\u001b[2J"'),
    "name-twice": 2 * _USER,
    "crowd": "".join(_USER.replace('"x"', f'"{i}"') for i in range(5000)),
    "deep": "user = " + "[" * 100_000,
    "binary": bytes(range(128, 256)),
}
"""Traffic files."""

_DROVE = "t_s,delta_rad,vx_mps,r_radps\n"
RECORDINGS: dict[str, str | bytes] = {
    "empty": "",
    "other-columns": "time,steer\n1,2\n2,3\n",
    "one-row": _DROVE + "0,0,10,0\n",
    "nan": _DROVE + "".join(f"{0.1 * i},nan,10,0\n" for i in range(100)),
    "a-word": _DROVE + "".join(f"{0.1 * i},left,10,0\n" for i in range(100)),
    "time-backwards": _DROVE + "".join(f"{-0.1 * i},0,10,0\n" for i in range(100)),
    "slow-motion": _DROVE + "".join(f"{1e6 * i},0,10,0\n" for i in range(100)),
    "in-degrees": _DROVE + "".join(f"{0.1 * i},90,10,0\n" for i in range(100)),
    "binary": bytes(range(128, 256)),
}
"""Recordings of a car."""

_BOMB = "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcde", "bcdef", strict=True))
CARS: dict[str, str | bytes] = {
    "empty": "",
    "no-xml": "not xml",
    "no-car": "<mujoco/>",
    "itself": "<mujoco><include file='itself.xml'/></mujoco>",
    "entities": f'<!DOCTYPE l [<!ENTITY a "aaaaaaaaaa">{_BOMB}]><mujoco model="&f;"/>',
    "binary": bytes(range(128, 256)),
}
"""Models of a car."""

_TIR = "[UNITS]\nLENGTH = 'meter'\nFORCE = 'newton'\nANGLE = 'radians'\n"
TIRES: dict[str, str | bytes] = {
    "empty": "",
    "no-coefficients": _TIR,
    "in-feet": _TIR.replace("meter", "foot"),
    "in-degrees": _TIR.replace("radians", "degree"),
    "a-word": _TIR + "[VERTICAL]\nFNOMIN = heavy\n",
    "nan": _TIR + "[VERTICAL]\nFNOMIN = nan\n",
    "long-number": _TIR + "[VERTICAL]\nFNOMIN = " + "9" * 100_000 + "\n",
    "binary": bytes(range(256)),
    "json": '{"FNOMIN": 4000}',
}
"""Tire property files."""

NETWORKS: dict[str, str | bytes] = {
    "empty": b"",
    "short": b"\x01\0\0",
    "long-header": b"\xff" * 8 + b"{}",
    "no-json": b"\x02\0\0\0\0\0\0\0[[",
    "deep-json": (100_000).to_bytes(8, "little") + b"[" * 100_000,
    "no-arrays": b"\x02\0\0\0\0\0\0\0{}",
    "text": "weights",
    "a-pickle": b"\x80\x04\x95\x0b\0\0\0\0\0\0\0\x8c\x02os\x94.",
}
"""Weights of networks."""

DATA: dict[str, str | bytes] = {
    "empty": b"",
    "short": b"PAR1",
    "no-footer": b"PAR1" + b"\0" * 100 + b"PAR1",
    "long-footer": b"PAR1" + b"\0" * 20 + b"\xff\xff\xff\x7fPAR1",
    "text": "vx_mps,vy_mps\n1,2\n",
    "binary": bytes(range(256)) * 10,
}
"""Data sets."""

SPECIAL = ("pipe", "folder", "missing", "/dev/zero", "/dev/null")
"""What a name may stand for besides a file."""


def write(folder: Path) -> None:
    """Write all of them into a folder, each kind in its own, with pipes and folders beside them."""
    for kind, ending, contents in KINDS:
        place = folder / kind
        place.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            raw = content if isinstance(content, bytes) else content.encode()
            (place / f"{name}{ending}").write_bytes(raw)
        (place / f"folder{ending}").mkdir(exist_ok=True)
        pipe = place / f"pipe{ending}"
        if not (pipe.exists() and stat.S_ISFIFO(pipe.stat().st_mode)):
            os.mkfifo(pipe)


def names(kind: str) -> Iterator[str]:
    """Names of the wrong files of a kind, relative to the folder, special ones among them."""
    ((ending, contents),) = ((e, c) for k, e, c in KINDS if k == kind)
    for name in (*contents, "pipe", "folder", "missing"):
        yield f"{kind}/{name}{ending}"


KINDS: tuple[tuple[str, str, dict[str, str | bytes]], ...] = (
    ("roads", ".csv", ROADS),
    ("weights", ".toml", WEIGHTS),
    ("worlds", ".toml", WORLDS),
    ("traffic", ".toml", TRAFFIC),
    ("recordings", ".csv", RECORDINGS),
    ("cars", ".xml", CARS),
    ("tires", ".tir", TIRES),
    ("networks", ".safetensors", NETWORKS),
    ("data", ".parquet", DATA),
)
"""Kind, ending of the names, and contents."""
