"""Writes tests/data/simplex_scipy.json: what SciPy's Nelder-Mead does.

Run by hand (`python3 tests/simplex_scipy.py`, numpy and scipy needed) when a
case is added; the result is committed. The functions use only + - * / in a
stated order, so that another implementation can repeat them bit by bit; those
marked `exact: false` also use exp and cos.
"""

import json
import math
import pathlib

import numpy as np
import scipy
from scipy.optimize import minimize


def rosenbrock(x):
    s = 0.0
    for i in range(len(x) - 1):
        a = x[i + 1] - x[i] * x[i]
        b = 1.0 - x[i]
        s = s + (100.0 * (a * a) + b * b)
    return s


def ellipsoid(x):
    s = 0.0
    for i in range(len(x)):
        d = x[i] - 0.25 * i
        s = s + (1.0 + 3.0 * i) * (d * d)
    return s


def absolute(x):
    s = 0.0
    for i in range(len(x)):
        s = s + (i + 1.0) * abs(x[i] - 0.5)
    return s


def plateau(x):
    """Flat in steps: many ties, many shrinks."""
    s = 0.0
    for i in range(len(x)):
        s = s + math.floor(8.0 * (x[i] * x[i])) / 8.0
    return s


def powell(x):
    a, b, c, d = (float(v) for v in x)
    p = a + 10.0 * b
    q = c - d
    r = b - 2.0 * c
    t = a - d
    return p * p + 5.0 * (q * q) + (r * r) * (r * r) + 10.0 * ((t * t) * (t * t))


def wave(x):
    s = 0.0
    for i in range(len(x)):
        s = s + x[i] * x[i] - math.cos(3.0 * x[i]) * math.exp(-x[i] * x[i])
    return s


FUNCTIONS = {f.__name__: f for f in (rosenbrock, ellipsoid, absolute, plateau, powell, wave)}
CASES = [
    ("rosenbrock", [-1.2, 1.0], {}, True),
    ("rosenbrock", [-1.2, 1.0, 0.0, 0.5, 2.0], {}, True),
    ("rosenbrock", [0.0, 0.3, -0.2, 0.5, 0.0, -0.7, 0.9, 0.1, -0.4, 0.6], {"maxfev": 1000}, True),
    ("ellipsoid", [1.0, 0.0, -2.0, 4.0, 0.0, 0.125], {"xatol": 1e-8, "fatol": 1e-8}, True),
    ("ellipsoid", [0.0] * 21, {"maxfev": 120}, True),
    ("ellipsoid", [400.0] + [0.0] * 14, {"maxiter": 300}, True),
    ("absolute", [2.0, -1.0, 3.0], {}, True),
    ("absolute", [0.0, 0.0, 0.0, 7.0], {"maxfev": 3}, True),
    ("plateau", [1.5, -0.75, 2.0], {"maxfev": 60}, True),
    ("powell", [3.0, -1.0, 0.0, 1.0], {}, True),
    ("powell", [3.0, -1.0, 0.0, 1.0], {"maxfev": 77, "maxiter": 1000}, True),
    ("wave", [2.0, -1.5, 0.3], {}, False),
]

cases = []
for name, start, options, exact in CASES:
    r = minimize(lambda x, f=FUNCTIONS[name]: float(f(x)), np.array(start), method="Nelder-Mead", options=options)
    cases.append(
        {
            "function": name,
            "start": start,
            "maxiter": options.get("maxiter"),
            "maxfev": options.get("maxfev"),
            "xatol": options.get("xatol", 1e-4),
            "fatol": options.get("fatol", 1e-4),
            "exact": exact,
            "x": [float(v) for v in r.x],
            "fun": float(r.fun),
            "nit": int(r.nit),
            "nfev": int(r.nfev),
            "status": int(r.status),
            "simplex": [[float(v) for v in row] for row in r.final_simplex[0]],
        }
    )
path = pathlib.Path(__file__).parent / "data" / "simplex_scipy.json"
path.write_text(json.dumps({"scipy": scipy.__version__, "numpy": np.__version__, "cases": cases}, indent=1) + "\n")
print(f"{path}: {len(cases)} cases")
