"""Start of the command line, which is interrupted cleanly even while Python still imports it."""

import os
import sys


def main() -> None:
    """Run the command line."""
    if sys.stderr is None:  # it was closed: remarks have no place to go, the answer has
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115, PTH123
    try:
        from energyplan.cli import main as run
    except KeyboardInterrupt:
        sys.stderr.write("energyplan: interrupted; no file is half written\n")
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
