"""Commands, run as from a shell."""

import json
from collections.abc import Callable
from typing import Any, NamedTuple

import pytest

from energyplan import cli


class Result(NamedTuple):
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        """Return its answer, where it had to give one."""
        assert self.code == 0, self.err
        return json.loads(self.out)


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> Result:
    """Run a command; return its exit code and what it printed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["energyplan", *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            cli.main()
    return Result(int(left.value.code or 0), *capsys.readouterr())


Run = Callable[..., Result]
