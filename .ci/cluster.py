#!/usr/bin/env python3
"""Checks that a sweep survives failures of a cluster: cluster.py PROGRAM.

Starts a Ray cluster of two nodes on this machine, runs a sweep on it, kills a worker and then a node during the sweep, and
compares all rows except the run times bit by bit with those of a single-machine run.
"""
import glob
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import threading
import time

import pyarrow
import pyarrow.parquet
import ray
from ray.cluster_utils import Cluster

HERE = pathlib.Path(__file__).resolve().parent
DRIVER = str(HERE.parent / "src" / "sweep")
sys.path.insert(0, DRIVER)
os.environ["PYTHONPATH"] = DRIVER  # for the workers
os.environ["RAY_worker_niceness"] = "0"  # by default, workers yield to everything else on this machine
import on_ray

SWEEP = """scene = "two"
until = "end"
[[axis]]
key = "influence.split_at"
from = 1.1
to = 1.5
count = 65
[[axis]]
key = "influence.merge_at"
from = 0.9
to = 1.09
count = 65
"""
REFINE, SHARDS = 1, 8


def rows(folder):
    tables = [pyarrow.parquet.read_table(path) for path in glob.glob(f"{folder}/rows-*.parquet")]
    table = pyarrow.concat_tables(tables).sort_by("row")
    numbers = table["row"].to_pylist()
    assert len(numbers) == len(set(numbers)), "duplicate rows"
    return table.drop_columns(["run_time"])


def workers(raylet):
    """The worker processes of a node that are running a shard."""
    found = []
    for path in glob.glob("/proc/[0-9]*"):
        try:
            status = pathlib.Path(path, "status").read_text()
            command = pathlib.Path(path, "cmdline").read_bytes()
        except OSError:
            continue
        if f"PPid:\t{raylet}\n" in status and command.startswith(b"ray::shard"):
            found.append(int(path.rsplit("/", 1)[1]))
    return found


def main():
    program = os.path.abspath(sys.argv[1])
    with tempfile.TemporaryDirectory() as folder:
        sweep = f"{folder}/sweep.toml"
        pathlib.Path(sweep).write_text(SWEEP)
        command = lambda out: [program, "sweep", sweep, "--out", f"{folder}/{out}", "--refine", str(REFINE)]
        cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
        second = cluster.add_node(num_cpus=1)
        ray.init(address=cluster.address, logging_level="error", log_to_driver=False)
        killed = []

        def disturb():
            """Kills a worker as soon as one runs on the second node, then that node."""
            first, raylet = (node.all_processes["raylet"][0].process.pid for node in (cluster.head_node, second))
            for _ in range(6000):
                busy = workers(raylet)
                if busy:
                    os.kill(busy[0], signal.SIGKILL)
                    killed.append("worker")
                    break
                time.sleep(0.01)
            # The first node waits, or it could end the sweep before a worker runs on the second one again.
            waiting = set()
            for _ in range(6000):
                if workers(raylet):
                    cluster.remove_node(second, allow_graceful=False)
                    killed.append("node")
                    break
                for worker in set(workers(first)) - waiting:
                    os.kill(worker, signal.SIGSTOP)
                    waiting.add(worker)
                time.sleep(0.01)
            for worker in waiting:
                os.kill(worker, signal.SIGCONT)

        thread = threading.Thread(target=disturb)
        thread.start()
        on_ray.run(command("cluster"), REFINE, SHARDS)
        thread.join()
        ray.shutdown()
        cluster.shutdown()
        assert killed == ["worker", "node"], killed
        subprocess.run(command("plain"), check=True, stdout=subprocess.DEVNULL)
        plain, clustered = rows(f"{folder}/plain"), rows(f"{folder}/cluster")
        assert plain.equals(clustered), "the rows differ"
        print(f"{plain.num_rows} rows, the same after a worker and a node were killed")


if __name__ == "__main__":
    main()
