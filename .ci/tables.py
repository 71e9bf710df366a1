#!/usr/bin/env python3
"""Reads exported tables with polars, DuckDB and Python itself: tables.py FOLDER.

FOLDER has the same tables (events, pairs, scalars, states) as .csv, .json and .parquet. All readers must find the same
bits in all formats. tests/suite/cli.rs checks that the .csv has the bits of the state.
"""
import csv
import json
import pathlib
import struct
import sys

import duckdb
import polars

COUNTS = {"step", "vertex"}
TEXTS = {"event", "a", "b", "from", "to", "surfaces", "phase", "body"}


def bits(name, value):
    if name in TEXTS:
        return value or None
    if name in COUNTS:
        return int(value)
    return None if value in (None, "") else struct.pack("<d", float(value))


def columns(rows, names):
    return {name: [bits(name, row[name]) for row in rows] for name in names}


def main():
    folder = pathlib.Path(sys.argv[1])
    for table in ("events", "pairs", "scalars", "states"):
        path = {format: str(folder / f"{table}.{format}") for format in ("csv", "json", "parquet")}
        with open(path["csv"], newline="") as file:
            rows = list(csv.DictReader(file))
        names = list(rows[0])
        expected = columns(rows, names)
        with open(path["json"]) as file:
            found = {"Python's json": columns(json.load(file), names)}
        found["polars.read_csv"] = columns(polars.read_csv(path["csv"]).to_dicts(), names)
        found["polars.read_json"] = columns(polars.read_json(path["json"]).to_dicts(), names)
        found["polars.read_parquet"] = columns(polars.read_parquet(path["parquet"]).to_dicts(), names)
        for format in path:
            result = duckdb.sql(f"from '{path[format]}'")
            found[f"DuckDB, {format}"] = columns([dict(zip(result.columns, row)) for row in result.fetchall()], names)
        for reader, seen in found.items():
            different = [name for name in names if seen[name] != expected[name]]
            if different:
                first = next(i for i, pair in enumerate(zip(seen[different[0]], expected[different[0]])) if pair[0] != pair[1])
                sys.exit(f"{table}: {reader} differs in {different}, first in row {first}: {rows[first]}")
        print(f"{table}: {len(rows)} rows, {len(names)} columns, the same bits from {len(found) + 1} readers")


if __name__ == "__main__":
    main()
