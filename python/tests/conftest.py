"""Data that several tests share."""

import json
import re
import subprocess
import sysconfig
from pathlib import Path

import numpy as np
import pytest

DATA = Path(__file__).resolve().parents[2] / "tests" / "data"
#: The command that the wheel installed.
SPHERECAL = str(Path(sysconfig.get_path("scripts")) / "spherecal")
SOCKETS = {1: (0.0, 0.0, 0.0, 5e-6), 2: (0.05, 0.0, 0.0, 5e-6)}


@pytest.fixture(scope="session")
def data() -> Path:
    """Reference data of the project; their README states origin and licence."""
    return DATA


@pytest.fixture(scope="session")
def mukca() -> dict:
    """The public MUKCa data as `spherecal.identify` takes them."""
    table = np.genfromtxt(DATA / "mukca_iiwa14.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    return {
        "q": np.column_stack([table[f"q{k}"] for k in range(1, 8)]),
        "sphere": table["sphere"],
        "place": table["place"],
        "plate": SOCKETS,
        "robot": str(DATA / "iiwa14.urdf"),
    }


@pytest.fixture(scope="session")
def command():
    """Runs the wheel's own command `spherecal`."""

    def run(*arguments, timeout=600, cwd=None):
        return subprocess.run(
            [SPHERECAL, *map(str, arguments)],
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
            cwd=cwd,
        )

    return run


def leaves(value, path=""):
    """All numbers and words of a document, by their place in it."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from leaves(inner, f"{path}.{key}")
    elif isinstance(value, list):
        for key, inner in enumerate(value):
            yield from leaves(inner, f"{path}[{key}]")
    else:
        yield path, value


ROW = re.compile(r"row \d+|\S+ line \d+")


def same(ours: dict, theirs: dict) -> None:
    """Asserts that two documents agree to 1e-12, but for the time that they took."""
    ours, theirs = dict(leaves(ours)), dict(leaves(theirs))
    assert ours.keys() == theirs.keys()
    for place, value in ours.items():
        if place == ".wall_s":
            continue
        other = theirs[place]
        if isinstance(value, float) and isinstance(other, (int, float)):
            assert abs(value - other) <= 1e-12 * max(1.0, abs(other)), (place, value, other)
        elif isinstance(value, str):
            # Rows are named by the table that they stand in, of which arrays have none.
            assert ROW.split(value)[0] == ROW.split(other)[0], (place, value, other)
        else:
            assert value == other, (place, value, other)


def summary_of(folder: Path) -> dict:
    """The summary that the command wrote."""
    return json.loads((folder / "summary.json").read_text(encoding="utf-8"))
