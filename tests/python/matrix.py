"""Checks dataset folders with other tools. `tests/python/run.sh` generates the folders and runs this file.

Each check is a function of a folder, named after what it checks. `files.py` checks names, Parquet, card and PNG, `tools.py`
opens the folder with `datasets`, DuckDB and polars, and `geometry.py` recomputes the numbers.
"""

import sys
import time
import traceback

import files
import geometry
import tools
from folder import Folder, Unexpected


def checks_of(folder):
    for module in (files, tools, geometry):
        names = module.CHECKS + getattr(module, "CHECKS_OF", {}).get(folder.kind, [])
        yield from (getattr(module, name) for name in names)


def main():
    run = failed = 0
    start = time.monotonic()
    for path in sys.argv[1:]:
        folder = Folder(path)
        for check in checks_of(folder):
            run += 1
            try:
                check(folder)
            except Unexpected as unexpected:
                failed += 1
                print(f"FAILED {folder.kind}: {check.__name__}\n  {unexpected}")
            except Exception:
                failed += 1
                print(f"FAILED {folder.kind}: {check.__name__}\n{traceback.format_exc()}")
    seconds = time.monotonic() - start
    print(f"{run - failed} of {run} checks of datasets from Python pass ({seconds:.0f} s)")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
