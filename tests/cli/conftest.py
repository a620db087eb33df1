"""Commands for the tests of this folder."""

from collections.abc import Callable
from functools import partial

import commands
import pytest


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., commands.Result]:
    """Run a command as from a shell."""
    return partial(commands.run, capsys)
