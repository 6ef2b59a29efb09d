"""Lists the rests of an arm in a dataset of LeRobot as joint angles, for the table of `spherecal identify`.

    python lerobot_joints.py DATASET > joints.csv
    python lerobot_joints.py DATASET --calibration so101.json > joints.csv

The joints are those of `observation.state`, in degrees. Where the arm was recorded in shares of its ranges (-100 to 100),
`--calibration` names its calibration file of LeRobot, whose ranges make degrees of them. A dataset does not say where the tool
was: add x_mm, y_mm, z_mm of an instrument to each row. It needs Python 3.10 and pyarrow.
"""

import argparse
import csv
import json
import pathlib
import sys

import pyarrow.parquet as pq

LAST_STEP = 4095  # of a servo's turn: LeRobot divides by it


def rests(frames, band, least_s):
    """Mean time (s) and mean state of each time in which no joint leaves the band for `least_s`."""
    still = []
    for frame in [*frames, None]:
        now = still if frame is None else [*still, frame]
        if frame and all(max(joint) - min(joint) <= band for joint in zip(*(state for _, state in now), strict=True)):
            still = now
            continue
        if still and still[-1][0] - still[0][0] >= least_s:
            mean = [sum(joint) / len(still) for joint in zip(*(state for _, state in still), strict=True)]
            yield sum(time for time, _ in still) / len(still), mean
        still = [frame]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=pathlib.Path)
    parser.add_argument("--calibration", type=pathlib.Path)
    parser.add_argument("--gripper", default="gripper")
    parser.add_argument("--band", type=float, default=0.3)
    parser.add_argument("--rest-s", type=float, default=0.3)
    given = parser.parse_args()
    names = json.loads((given.dataset / "meta/info.json").read_text())["features"]["observation.state"]["names"]
    names = [name.split(".")[0] for name in (names["motors"] if isinstance(names, dict) else names)]
    arm = [k for k, name in enumerate(names) if name != given.gripper]
    to_degrees = [1.0] * len(names)
    if given.calibration:
        servos = [json.loads(given.calibration.read_text())[name] for name in names]
        sign = [-1 if servo.get("drive_mode") else 1 for servo in servos]
        span = [servo["range_max"] - servo["range_min"] for servo in servos]
        to_degrees = [s * n / 200 * 360 / LAST_STEP for s, n in zip(sign, span, strict=True)]
    columns = ["observation.state", "timestamp", "episode_index"]
    episodes = {}
    for path in sorted((given.dataset / "data").rglob("*.parquet")):
        for row in pq.read_table(path, columns=columns).to_pylist():
            state = [row["observation.state"][k] * to_degrees[k] for k in arm]
            episodes.setdefault(row["episode_index"], []).append((row["timestamp"], state))
    out = csv.writer(sys.stdout, lineterminator="\n")
    out.writerow([*(f"{names[k]}_deg" for k in arm), "time"])
    for _, frames in sorted(episodes.items()):
        for time, state in rests(frames, given.band, given.rest_s):
            out.writerow([*(f"{angle:.4f}" for angle in state), f"{time:.2f}"])


if __name__ == "__main__":
    main()
