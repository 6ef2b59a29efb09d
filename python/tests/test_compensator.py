"""The stand-alone compensator of examples/python: the numbers of the package."""

import importlib.util

import numpy as np
import pytest
from conftest import DATA

import spherecal

PATH = DATA.parents[1] / "examples" / "python" / "compensator.py"


@pytest.fixture(scope="module")
def module():
    spec = importlib.util.spec_from_file_location("compensator", PATH)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_it_is_the_full_model_of_the_file(module, mukca, tmp_path):
    """Fails if the file lacks a number of the full model, or if the example computes another one."""
    found = spherecal.identify(**mukca)
    found.write(tmp_path)
    compensator = module.Compensator(tmp_path / "calibrated.toml")
    q = np.asarray(mukca["q"])[::9]
    for angles, point in zip(q, found.predict(q), strict=True):
        assert np.linalg.norm(compensator.tcp(angles) - point) < 1e-9
        command = compensator.command(angles)
        wanted, flange = compensator.nominal_pose(angles)
        assert np.linalg.norm(found.predict(command[None])[0] - wanted) < 1e-8
        theirs = found.compensate(angles[None])[0]
        assert np.linalg.norm(found.predict(theirs[None])[0] - wanted) < 1e-8
    with pytest.raises(ValueError):
        compensator.command([np.nan] * 7)
    with pytest.raises(module.Unreachable):
        compensator.command(np.zeros(7))
