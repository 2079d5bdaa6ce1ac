"""Checks dataset folders from outside: `tests/python/run.sh` makes them and runs this.

Each check is a function of a folder; its name says what holds. `files.py` looks at names, Parquet, card and PNG, `tools.py`
opens the folder with `datasets`, DuckDB and polars, `geometry.py` computes the numbers again.
"""

import sys
import time
import traceback

import files
import geometry
import tools
from folder import Folder, Unexpected


def main():
    checks = [getattr(module, name) for module in (files, tools, geometry) for name in module.CHECKS]
    failed, start = 0, time.monotonic()
    for path in sys.argv[1:]:
        folder = Folder(path)
        for check in checks:
            try:
                check(folder)
            except Unexpected as unexpected:
                failed += 1
                print(f"FAILED {folder.kind}: {check.__name__}\n  {unexpected}")
            except Exception:
                failed += 1
                print(f"FAILED {folder.kind}: {check.__name__}\n{traceback.format_exc()}")
    total = len(checks) * len(sys.argv[1:])
    seconds = time.monotonic() - start
    print(f"{total - failed} of {total} checks of datasets from Python hold ({seconds:.0f} s)")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
