"""Holds our forward kinematics against yourdfpy's of the URDF that we wrote.

    check_urdf.py FILE.urdf CASES.json

CASES.json: {"base": link, "flange": link, "joints": [names],
"cases": [{"q": [rad], "pose": [[4 x 4]]}]}. Prints one line of JSON: the
largest distance in m and the largest rotation in rad.
"""

import json
import sys

import numpy
import yourdfpy

robot = yourdfpy.URDF.load(sys.argv[1], load_meshes=False, build_scene_graph=True)
cases = json.load(open(sys.argv[2]))
assert list(robot.actuated_joint_names) == cases["joints"], f"{robot.actuated_joint_names} {cases['joints']}"
distance = rotation = 0.0
for case in cases["cases"]:
    robot.update_cfg(numpy.array(case["q"]))
    theirs = robot.get_transform(cases["flange"], cases["base"])
    ours = numpy.array(case["pose"])
    distance = max(distance, float(numpy.linalg.norm(theirs[:3, 3] - ours[:3, 3])))
    rotation = max(rotation, float(numpy.abs(theirs[:3, :3] - ours[:3, :3]).max()))
print(json.dumps({"cases": len(cases["cases"]), "distance_m": distance, "rotation": rotation}))
