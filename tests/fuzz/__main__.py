"""Damage files by the thousand: `python tests/fuzz --mutations 100000 [--seed 1] [--readers npy,hdf5]`.

The trials of a reader run in a child process, so that one that crashes or hangs in a library is counted, and the next
goes on after it. `--show READER NUMBER` writes the damaged file of one trial, to be looked at.
"""

from __future__ import annotations

import argparse
import logging
import os
import select
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from fuzz.readers import READERS
from fuzz.trial import SECONDS, Trials

CLEAN = ("read", "refused")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mutations", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--readers", default=",".join(READERS))
    parser.add_argument("--show", nargs=2, metavar=("READER", "NUMBER"))
    options = parser.parse_args()
    logging.disable()  # what libraries think of the files
    if options.show:
        with tempfile.TemporaryDirectory() as folder:
            sys.stdout.buffer.write(Trials(options.show[0], Path(folder)).damage(options.seed, int(options.show[1])))
        return
    unclean = 0
    for name in options.readers.split(","):
        began, found = time.monotonic(), results(name, options.seed, options.mutations)
        counts, first = Counter(found), {what: number for number, what in reversed(list(enumerate(found)))}
        bad = sum(count for what, count in counts.items() if what not in CLEAN)
        unclean += bad
        said = f"{counts['read']:7} read {counts['refused']:7} refused {bad:6} unclean"
        print(f"{name:14} {said} {time.monotonic() - began:7.0f} s", flush=True)
        for what, count in counts.most_common():
            if what not in CLEAN:
                print(f"    {count:6}  {what}  (first: {first[what]})", flush=True)
    sys.exit(unclean > 0)


def results(name: str, seed: int, mutations: int) -> list[str]:
    """What came of each trial of one reader."""
    found: list[str] = []
    while len(found) < mutations:
        read_end, write_end = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(read_end)
            _child(name, seed, range(len(found), mutations), write_end)
        os.close(write_end)
        late = not _collect(read_end, found)
        os.close(read_end)
        if late:
            os.kill(child, signal.SIGKILL)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if status > 0:
            sys.exit(f"{name}: the fuzzer failed")
        if status < 0:
            found.append("hangs in a library" if late else f"crashes with {signal.Signals(-status).name}")
    return found


def _child(name: str, seed: int, numbers: range, pipe: int) -> None:
    try:
        with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as folder:
            trials = Trials(name, Path(folder))
            for number in numbers:
                os.write(pipe, trials.run(seed, number).encode("utf-8", "replace").replace(b"\n", b" ")[:400] + b"\n")
        os._exit(0)
    except BaseException as error:
        traceback.print_exception(error)
        os._exit(1)


def _collect(pipe: int, found: list[str]) -> bool:
    """Add what the child says until it ends; whether it did in time."""
    rest = b""
    while select.select([pipe], [], [], 3 * SECONDS)[0]:
        said = os.read(pipe, 1 << 16)
        if not said:
            return True
        *lines, rest = (rest + said).split(b"\n")
        found += [line.decode() for line in lines]
    return False


if __name__ == "__main__":
    main()
