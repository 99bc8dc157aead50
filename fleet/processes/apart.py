"""Several futures of one moment: a function that a copy of this process computes, so that this one stays as it is.

A copy by fork has one thread, the one that asked for it. So a process with other threads, as zenoh starts them, is not
copied. One copy is there at a time. It ends with this process, also where that is killed, and on every exception.
"""

from __future__ import annotations

import gc
import os
import pickle
import signal
from collections.abc import Callable
from typing import Any, TypeVar

from fleet.errors import RunBroken
from fleet.processes.child_start import die_with_parent

R = TypeVar("R")


def can_copy() -> bool:
    """Whether this process can be copied: it has one thread."""
    return len(os.listdir("/proc/self/task")) == 1


def in_child_process(make: Callable[[], R]) -> R:
    """What a function returns, called in a copy of this process.

    Args:
        make: the function; its result is pickled. It must not use files or processes that this process goes on with.

    Returns:
        Its result.

    Raises:
        Exception: what the function raised.
        RunBroken: the copy ended without an answer, for example because there was too little memory.
    """
    assert can_copy(), "a process with several threads is not copied"
    reading, writing = os.pipe()
    gc.freeze()  # a collection in the copy would touch, and so copy, everything
    parent = os.getpid()
    try:
        pid = os.fork()
    except OSError as error:
        os.close(reading)
        os.close(writing)
        gc.unfreeze()
        raise RunBroken(f"a run cannot be copied: {error.strerror}; is there enough memory?") from None
    if pid == 0:
        os.close(reading)
        _answer(writing, parent, make)
    gc.unfreeze()
    os.close(writing)
    try:
        with os.fdopen(reading, "rb") as answer:
            data = answer.read()
    except BaseException:
        os.kill(pid, signal.SIGKILL)
        raise
    finally:
        _, status = os.waitpid(pid, 0)
    if not data:
        raise RunBroken(f"the copy of a run ended without an answer ({_describe_end(status)}); is there enough memory?")
    failed, value = pickle.loads(data)
    if failed:
        raise value
    found: R = value
    return found


def _answer(writing: int, parent: int, make: Callable[[], Any]) -> None:
    """The life of the copy."""
    try:
        die_with_parent(parent)
        try:
            data = pickle.dumps((False, make()))
        except Exception as error:
            data = _pack_error(error)
        with os.fdopen(writing, "wb") as answer:
            answer.write(data)
        os._exit(0)
    finally:
        os._exit(1)


def _pack_error(error: Exception) -> bytes:
    """An exception for the parent. If it cannot travel, its text does."""
    try:
        data = pickle.dumps((True, error))
        pickle.loads(data)
    except Exception:
        return pickle.dumps((True, RuntimeError(f"{type(error).__name__}: {error!s:.500}")))
    return data


def _describe_end(status: int) -> str:
    code = os.waitstatus_to_exitcode(status)
    return f"signal {-code}" if code < 0 else f"exit status {code}"
