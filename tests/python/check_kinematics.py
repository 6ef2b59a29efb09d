"""Holds our forward kinematics against those of the joint origins that we wrote.

    check_kinematics.py FILE.yaml CASES.json

Reads the YAML as ROS descriptions do (PyYAML) and multiplies the origins in the
vendors' order: Universal Robots from base_link, which is turned by 180 degrees
about z towards the first origin's parent; Franka from link0 to joint8; any other
from the root link. CASES.json as for check_urdf.py, with the pose of the last
frame. Prints one line of JSON: the largest distance in m and the largest
rotation in rad.
"""

import json
import sys

import numpy
import yaml


def turn(axis, angle):
    x, y, z = axis
    k = numpy.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return numpy.eye(3) + numpy.sin(angle) * k + (1 - numpy.cos(angle)) * k @ k


def frame(origin):
    roll, pitch, yaw = (float(origin[key]) for key in ("roll", "pitch", "yaw"))
    out = numpy.eye(4)
    out[:3, :3] = turn((0, 0, 1), yaw) @ turn((0, 1, 0), pitch) @ turn((1, 0, 0), roll)
    out[:3, 3] = [float(origin[key]) for key in ("x", "y", "z")]
    return out


def joint(axis, angle):
    out = numpy.eye(4)
    out[:3, :3] = turn(axis, angle)
    return out


document = yaml.safe_load(open(sys.argv[1]))
cases = json.load(open(sys.argv[2]))
Z = (0, 0, 1)
base = numpy.eye(4)
if "kinematics" in document:
    origins = document["kinematics"]
    assert origins.pop("hash").startswith("calib_")
    if list(origins) == ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"]:
        base = joint(Z, numpy.pi)
    chain = [(frame(o), tuple(o.get(f"axis_{k}", d) for k, d in zip("xyz", Z))) for o in origins.values()]
else:
    assert list(document) == [f"joint{k}" for k in range(1, 9)], list(document)
    chain = [(frame(o["kinematic"]), Z) for o in document.values()]
distance = rotation = 0.0
for case in cases["cases"]:
    theirs = base
    angles = list(case["q"]) + [0.0] * (len(chain) - len(case["q"]))
    for (origin, axis), angle in zip(chain, angles):
        theirs = theirs @ origin @ joint(axis, angle)
    ours = numpy.array(case["pose"])
    distance = max(distance, float(numpy.linalg.norm(theirs[:3, 3] - ours[:3, 3])))
    rotation = max(rotation, float(numpy.abs(theirs[:3, :3] - ours[:3, :3]).max()))
print(json.dumps({"cases": len(cases["cases"]), "distance_m": distance, "rotation": rotation}))
