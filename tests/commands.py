"""A command in this process, with its exit status, what it prints and the error behind it."""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from unittest import mock


@dataclass(frozen=True)
class Result:
    exit_code: int
    stdout: str
    stderr: str
    exception: Exception | None

    @property
    def output(self) -> str:
        return self.stdout + self.stderr


def invoke(arguments: Sequence[Any]) -> Result:
    """The result of ``stiffbeam`` with these arguments."""
    from stiffbeam import cli

    out, err, errors, fail = io.StringIO(), io.StringIO(), [None], cli._fail

    def noted(error: Any, status: int) -> None:
        errors.append(error if isinstance(error, Exception) else ValueError(error))
        fail(error, status)

    code = 0
    with (
        mock.patch.object(sys, "argv", ["stiffbeam", *map(str, arguments)]), mock.patch.object(cli, "_fail", noted),
        contextlib.redirect_stdout(out), contextlib.redirect_stderr(err),
    ):  # fmt: skip
        try:
            cli.main()
        except SystemExit as stop:
            code = int(stop.code or 0)
    return Result(code, out.getvalue(), err.getvalue(), errors[-1])
