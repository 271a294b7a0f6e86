"""Print the calls of a command, as it runs: `mpirun -n 4 python docs/call_list.py DEPTH render FILE -o out.png`.

Rank 0 prints each function once, where it is called first, with its file and the first line of its docstring, down to
DEPTH calls. The last line counts the files of all functions that ran, without those that run only at an import.
"""

import inspect
import sys
from types import CodeType, FrameType

from clusterviz.cli import main
from clusterviz.cli.termination import launched_rank

seen: dict[CodeType, tuple[int, str]] = {}


def profile(frame: FrameType, event: str, _: object) -> None:
    """Note the functions of the package, and how many others of it they are called from."""
    code, depth = frame.f_code, 0
    named = code.co_flags & inspect.CO_OPTIMIZED and code.co_name[0] != "<"
    if event != "call" or code in seen or not named or "/clusterviz/" not in code.co_filename:
        return
    above = frame.f_back
    while above:
        if above.f_code.co_filename.startswith("<frozen importlib"):
            return
        depth += above.f_code in seen
        above = above.f_back
    seen[code] = depth, str(code.co_consts[0] or "").strip().split("\n")[0]


if __name__ == "__main__":
    most = int(sys.argv.pop(1))
    sys.setprofile(profile)
    try:
        main()
    finally:
        sys.setprofile(None)
        if launched_rank() in (None, 0):
            for code, (depth, line) in seen.items():
                if depth <= most:
                    print(f"{'  ' * depth}{code.co_qualname}  {code.co_filename.rpartition('/clusterviz/')[2]}  {line}")
            print(len({code.co_filename for code in seen}), "files,", len(seen), "functions")
