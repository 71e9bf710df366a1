#!/usr/bin/env python3
"""Runs a sweep on a Ray cluster level by level, each level as shards; retries lost shards.

    pip install ray
    python3 on_ray.py SWEEP.toml --out DIR [--refine N] [--shards N] [--address auto] [--program meldscope]

DIR and the program are at the same path on all nodes. There is nothing to merge: each shard writes its own files atomically,
and a shard that runs twice writes the same files. The last command draws the map.
"""
import argparse
import ctypes
import itertools
import os
import signal
import subprocess
import sys

import ray

COMPLETE = "complete, nothing is left to refine"


def end_with_parent():
    """Ends the program when the worker that started it is killed (Linux)."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


class ShardFailed(Exception):
    """The program failed in a way that a retry may fix: a full disk, a missing folder."""


@ray.remote(num_cpus=1, max_retries=10, retry_exceptions=[ShardFailed])
def shard(command, index, count, level):
    """Runs a shard of a level; returns its output. Raises SystemError for bad input, which a retry cannot fix."""
    options = ["--shard", f"{index}/{count}", "--level", str(level), "--threads", "1"]
    ran = subprocess.run(command + options, capture_output=True, text=True, preexec_fn=end_with_parent, check=False)
    if ran.returncode == 2:
        raise SystemError(ran.stderr.strip())
    if ran.returncode != 0:
        raise ShardFailed(ran.stderr.strip() or f"status {ran.returncode}")
    return ran.stdout.strip()


def run(command, refine, shards, say=print):
    """Runs all levels."""
    for level in itertools.count() if refine else [0]:
        if level > 0 and COMPLETE in ray.get(shard.remote(command, 0, shards, level)):
            break
        waiting = [shard.remote(command, index, shards, level) for index in range(shards)]
        for done in itertools.count(1):
            finished, waiting = ray.wait(waiting)
            ray.get(finished)  # raises the shard's exception
            say(f"level {level}: {done} of {shards} shards")
            if not waiting:
                break


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sweep")
    parser.add_argument("--out", required=True)
    parser.add_argument("--refine", type=int, default=0)
    parser.add_argument("--shards", type=int, help="per level [4 for each processor of the cluster]")
    parser.add_argument("--address", default=None, help="of the cluster; auto: the one running here [a new one]")
    parser.add_argument("--program", default="meldscope")
    arguments = parser.parse_args()

    ray.init(address=arguments.address, logging_level="warning")
    shards = arguments.shards or 4 * max(1, int(ray.cluster_resources().get("CPU", 1)))
    path = lambda name: os.path.abspath(name) if os.path.exists(name) else name  # or a built-in sweep
    command = [path(arguments.program), "sweep", path(arguments.sweep), "--out", os.path.abspath(arguments.out)]
    command += ["--refine", str(arguments.refine)]
    run(command, arguments.refine, shards)
    return subprocess.run(command, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
