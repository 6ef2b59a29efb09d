"""Reads exported Parquet tables with Arrow and holds them against the CSV.

    check_tables.py FOLDER

Prints one line of JSON: rows by table.
"""

import csv
import json
import math
import pathlib
import sys

import pyarrow.parquet

rows = {}
for path in sorted(pathlib.Path(sys.argv[1]).glob("*.parquet")):
    table = pyarrow.parquet.read_table(path).to_pydict()
    with open(path.with_suffix(".csv"), newline="") as file:
        lines = list(csv.DictReader(file))
    assert list(table) == list(lines[0]), f"{path.name}: columns differ"
    for name, column in table.items():
        assert len(column) == len(lines), f"{path.name}: {len(column)} rows, {len(lines)} in the CSV"
        for value, line in zip(column, lines):
            other = type(value)(line[name])
            same = value == other or (isinstance(value, float) and math.isnan(value) and math.isnan(other))
            assert same, f"{path.name}: {name}: {value} and {line[name]}"
    rows[path.stem] = len(lines)
print(json.dumps(rows))
