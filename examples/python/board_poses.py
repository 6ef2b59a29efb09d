"""Makes a table of poses from images of a ChArUco board on the tool, for `spherecal identify`.

    python board_poses.py camera.json joints.csv --squares 7,5 --square-mm 30 --marker-mm 22 > poses.csv

`joints.csv` names an image in the column `image`, and has the joint columns of that row (q1,q2,..). `camera.json` has the
camera's `matrix` (3 x 3, pixels) and `distortion`, as `cv2.calibrateCamera` finds them; images must be sharp, and taken at rest.
It needs Python 3.10 and opencv-contrib-python 4.8 or newer. docs/sources.md says what comes next.
"""

import argparse
import csv
import json
import pathlib
import sys

import cv2
import numpy as np


def board_pose(image, detector, board, matrix, distortion, most_px):
    """Position (m) and rotation vector (rad) of the board in the camera's frame, or why there is none."""
    corners, ids, _, _ = detector.detectBoard(image)
    if ids is None or len(ids) < 8:
        return None, f"{0 if ids is None else len(ids)} corners were seen, 8 are needed"
    on_board, in_image = board.matchImagePoints(corners, ids)
    found, turn, at = cv2.solvePnP(on_board, in_image, matrix, distortion)
    if not found:
        return None, "no pose fits the corners"
    again = cv2.projectPoints(on_board, turn, at, matrix, distortion)[0]
    off = np.sqrt(((again.reshape(-1, 2) - in_image.reshape(-1, 2)) ** 2).sum(axis=1).mean())
    if off > most_px:
        return None, f"the corners are {off:.1f} px from the pose"
    return [*at.ravel(), *turn.ravel()], None


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("camera"), parser.add_argument("joints")
    parser.add_argument("--squares", default="7,5"), parser.add_argument("--dictionary", default="DICT_APRILTAG_36h11")
    parser.add_argument("--square-mm", type=float, required=True), parser.add_argument("--marker-mm", type=float, required=True)
    parser.add_argument("--most-px", type=float, default=1.0)
    given = parser.parse_args()
    camera = json.loads(pathlib.Path(given.camera).read_text())
    matrix, distortion = np.array(camera["matrix"]), np.array(camera["distortion"])
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, given.dictionary))
    size = tuple(int(n) for n in given.squares.split(","))
    board = cv2.aruco.CharucoBoard(size, given.square_mm / 1e3, given.marker_mm / 1e3, dictionary)
    detector = cv2.aruco.CharucoDetector(board)
    with open(given.joints, newline="") as file:
        rows = list(csv.DictReader(file))
    names = [name for name in rows[0] if name != "image"]
    out = csv.writer(sys.stdout, lineterminator="\n")
    out.writerow([*names, "x_m", "y_m", "z_m", "rotvec_x", "rotvec_y", "rotvec_z"])
    for row in rows:
        path = pathlib.Path(given.joints).parent / row["image"]
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            sys.exit(f"{path}: is no image")
        pose, why = board_pose(image, detector, board, matrix, distortion, given.most_px)
        if pose is None:
            print(f"{path}: left out: {why}", file=sys.stderr)
        else:
            out.writerow([*(row[name] for name in names), *(f"{number:.9f}" for number in pose)])


if __name__ == "__main__":
    main()
