"""Writes a small dataset of LeRobot (version 3): FOLDER. Two episodes of two joints and a gripper at 10 Hz."""

import json
import pathlib
import sys

import pyarrow as pa
import pyarrow.parquet as pq

folder = pathlib.Path(sys.argv[1])
names = ["shoulder_pan.pos", "elbow_flex.pos", "gripper.pos"]
rows = {"observation.state": [], "timestamp": [], "episode_index": []}


def put(episode, *rests):
    """A second of rest at each, and a second of motion to the next."""
    time = 0
    for rest, following in zip(rests, [*rests[1:], None], strict=True):
        for step in range(11 if following is None else 20):
            part = max(0, step - 10) / 10 if following else 0
            aim = following or rest
            rows["observation.state"].append([a + part * (b - a) for a, b in zip(rest, aim, strict=True)])
            rows["timestamp"].append(time / 10)
            rows["episode_index"].append(episode)
            time += 1


put(0, [10.0, -20.0, 3.0], [30.0, -40.0, 60.0])
put(1, [-5.0, 15.0, 3.0])
(folder / "data/chunk-000").mkdir(parents=True)
(folder / "meta").mkdir()
state = pa.array(rows["observation.state"], pa.list_(pa.float32(), 3))
table = pa.table({**rows, "observation.state": state})
pq.write_table(table, folder / "data/chunk-000/file-000.parquet")
feature = {"dtype": "float32", "shape": [3], "names": names}
(folder / "meta/info.json").write_text(json.dumps({"codebase_version": "v3.0", "features": {"observation.state": feature}}))
print(json.dumps({"rows": len(table)}))
