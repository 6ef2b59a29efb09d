"""The same identifications as benches/identify.rs, in NumPy: what the times are read against.

Reads the contacts that the benchmark wrote (q1..q7 in rad, sphere index) and
times, single-threaded, Gauss-Newton with the same columns and priors:
geometry (31 unknowns and 9 of the spheres), or the full structured model
(compliance, bending, tilt, 12 harmonics a joint) with its covariance. All of
the arithmetic is vectorised over the poses.

    OMP_NUM_THREADS=1 python3 numpy_identify.py geometry|structured FILE.csv

Prints the best time of several, in ms.
"""

import sys
import time

import numpy as np

ALPHA = np.array([0, -1, 1, 1, -1, -1, 1]) * np.pi / 2
D = np.array([0.34, 0, 0.4, 0, 0.4, 0, 0.126])
TOOL = np.array([0.05, 0.0, 0.1])
SPHERES = np.array([[0, 0, 0], [0.300009, 0, 0], [0.150049, 0.260051, 0]])
ORDERS = 12


def frames(rows, q):
    """Rotations (N, 7, 3, 3) and origins (N, 7, 3) of modified DH frames."""
    n = len(q)
    rotation, origin = np.broadcast_to(np.eye(3), (n, 3, 3)), np.zeros((n, 3))
    rotations, origins = [], []
    for i in range(7):
        alpha, a, theta, d = rows[i]
        ca, sa = np.cos(alpha), np.sin(alpha)
        c, s = np.cos(q[:, i] + theta), np.sin(q[:, i] + theta)
        zero = np.zeros(n)
        local = np.stack(
            [
                np.stack([c, -s, zero], 1),
                np.stack([s * ca, c * ca, np.full(n, -sa)], 1),
                np.stack([s * sa, c * sa, np.full(n, ca)], 1),
            ],
            1,
        )
        origin = origin + rotation @ np.array([a, -sa * d, ca * d])
        rotation = rotation @ local
        rotations.append(rotation)
        origins.append(origin)
    return np.stack(rotations, 1), np.stack(origins, 1)


def fit(q, sphere, structured):
    """Gauss-Newton to the mode; returns the covariance's diagonal."""
    n = len(q)
    rows = np.stack([ALPHA, np.zeros(7), np.zeros(7), D], 1)
    tool, base, turn = TOOL.copy(), np.zeros(3), np.eye(3)
    steps = 6 if structured else 5
    effects = 0
    if structured:
        k = np.arange(1, ORDERS + 1)
        phases = q[:, :, None] * k
        basis = np.concatenate([np.cos(phases), np.sin(phases)], 2)
        effects = 7 * (3 + 2 * ORDERS) + 2
    size = 27 + 6 + 9 + effects
    sigma = np.full(size, 1.0)
    sigma[:24] = np.tile([5e-4, 5e-4, 1e-3, 5e-4], 6)
    sigma[24:27] = 1.5e-3
    sigma[27:33] = 10.0
    sigma[33:42] = 1.4e-6
    sigma[42:] = 1e-4
    deviation = np.zeros(size)
    for step in range(steps):
        rotation, origin = frames(rows, q)
        tcp = np.einsum("nij,j->ni", rotation[:, 6], tool) + origin[:, 6]
        arm = tcp[:, None] - origin
        axis = rotation[:, :, :, 2]
        along = np.cross(axis, arm)
        parent = np.concatenate([np.broadcast_to(np.eye(3), (n, 1, 3, 3)), rotation[:, :-1]], 1)
        before = np.concatenate([np.zeros((n, 1, 3)), origin[:, :-1]], 1)
        x = parent[:, :, :, 0]
        blocks = np.stack([np.cross(x, tcp[:, None] - before), x, along, axis], 2)
        columns = [np.swapaxes(blocks[:, 1:].reshape(n, 24, 3), 1, 2), rotation[:, 6]]
        target = (SPHERES[sphere] - base) @ turn
        if step == 0:
            # Register the base to the nominal robot.
            p, s = tcp - tcp.mean(0), SPHERES[sphere] - SPHERES[sphere].mean(0)
            u, _, vt = np.linalg.svd(p.T @ s)
            turn = (u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt).T
            base = SPHERES[sphere].mean(0) - turn @ tcp.mean(0)
            target = (SPHERES[sphere] - base) @ turn
        eye = np.broadcast_to(turn.T, (n, 3, 3))
        pivot = tcp - tcp.mean(0)
        turns = np.stack([np.cross(np.broadcast_to(turn[a], (n, 3)), pivot) for a in range(3)], 2)
        spheres = np.zeros((n, 3, 9))
        for a in range(3):
            spheres[np.arange(n), :, 3 * sphere + a] = -turn.T[:, a]
        columns += [eye, turns, spheres]
        if structured:
            load = np.cross(arm, [0, 0, 30.0])
            bend = np.stack([np.cross(rotation[:, :, :, a], arm) * load[:, :, a : a + 1] for a in (0, 1)], 2)
            columns.append(np.swapaxes(bend.reshape(n, 14, 3), 1, 2))
            columns.append(np.swapaxes(along * load[:, :, 2:], 1, 2))
            columns.append(np.stack([np.cross([1, 0, 0], tcp), np.cross([0, 1, 0], tcp)], 2))
            harmonic = along[:, :, None, :] * basis[:, :, :, None]
            columns.append(np.swapaxes(harmonic.reshape(n, 14 * ORDERS, 3), 1, 2))
        jacobian = np.concatenate(columns, 2)
        residual = tcp - target
        covariance = 1e-8 * np.einsum("nji,njk->nik", along, along) + 1e-10 * np.eye(3)
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        white, r = root @ jacobian, np.einsum("nij,nj->ni", root, residual)
        weight = np.sqrt(7.0 / (4.0 + np.sum(r * r, 1)))
        flat = (white * weight[:, None, None]).reshape(3 * n, size)
        normal = flat.T @ flat + np.diag(sigma**-2.0)
        gradient = flat.T @ (r * weight[:, None]).reshape(-1) + deviation * sigma**-2.0
        delta = -np.linalg.solve(normal, gradient)
        deviation += delta
        rows[1:] += delta[:24].reshape(6, 4)
        tool += delta[24:27]
        base += delta[27:30]
        a, b, c = delta[30:33]
        u, _, vt = np.linalg.svd((np.eye(3) + np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]])) @ turn)
        turn = u @ vt
    return np.diag(np.linalg.inv(normal)) if structured else deviation


def main():
    """Times the model that the arguments name."""
    data = np.loadtxt(sys.argv[2], delimiter=",", skiprows=1)
    q, sphere = data[:, :7], data[:, 7].astype(int)
    best = np.inf
    for _ in range(7):
        start = time.perf_counter()
        fit(q, sphere, sys.argv[1] == "structured")
        best = min(best, time.perf_counter() - start)
    print(f"{best * 1e3:.2f}")


main()
