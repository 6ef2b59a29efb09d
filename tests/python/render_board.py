"""Renders a ChArUco board as a camera sees it: SPECIFICATION FOLDER.

The specification (JSON) has the camera's `matrix`, the board (`squares`, `square_m`, `marker_m`, `dictionary`), `noise`
(grey levels, 1 sigma) and `poses`: position (m) and rotation (9 numbers, row by row) of the board in the camera's frame.
Writes 0.png, 1.png .. into the folder; prints how many.
"""

import json
import pathlib
import sys

import cv2
import numpy as np

PIXELS_PER_M = 8000
FINER = 3

specification = json.loads(pathlib.Path(sys.argv[1]).read_text())
folder = pathlib.Path(sys.argv[2])
matrix = np.array(specification["matrix"])
dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, specification["dictionary"]))
squares, square = specification["squares"], specification["square_m"]
board = cv2.aruco.CharucoBoard(tuple(squares), square, specification["marker_m"], dictionary)
size = [round(n * square * PIXELS_PER_M) for n in squares]
print_ = board.generateImage(size)
# Pixel k of the print is centred at k + 1/2.
to_m = np.array([[1 / PIXELS_PER_M, 0, 0.5 / PIXELS_PER_M], [0, 1 / PIXELS_PER_M, 0.5 / PIXELS_PER_M], [0, 0, 1]])
finer = np.array([[FINER, 0, (FINER - 1) / 2], [0, FINER, (FINER - 1) / 2], [0, 0, 1]])
random = np.random.default_rng(5)
for number, pose in enumerate(specification["poses"]):
    rotation = np.array(pose["rotation"]).reshape(3, 3)
    seen = matrix @ np.column_stack([rotation[:, 0], rotation[:, 1], pose["position"]])
    large = cv2.warpPerspective(
        print_, finer @ seen @ to_m, (640 * FINER, 480 * FINER), flags=cv2.INTER_AREA, borderValue=220
    )
    image = cv2.resize(large, (640, 480), interpolation=cv2.INTER_AREA).astype(float)
    image += random.normal(0, specification["noise"], image.shape)
    cv2.imwrite(str(folder / f"{number}.png"), np.clip(image, 0, 255).astype(np.uint8))
print(json.dumps({"images": len(specification["poses"])}))
