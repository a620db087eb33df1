"""Start of the command line, which is interrupted cleanly even while Python still imports it."""

import sys


def main() -> None:
    """Run the command line."""
    try:
        from energyplan.cli import main as run
    except KeyboardInterrupt:
        sys.stderr.write("energyplan: interrupted; no file is half written\n")
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
