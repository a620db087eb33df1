"""Commands, run as from a shell."""

import pytest

from energyplan import cli


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Run a command; return its exit code and what it printed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["energyplan", *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            cli.main()
    printed = capsys.readouterr()
    return int(left.value.code or 0), printed.out, printed.err
