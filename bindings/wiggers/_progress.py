"""Progress of long calls: True shows a bar (tqdm where it is installed), a function is called, None is silent."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ._checks import shown
from ._core import InputError

Progress = bool | Callable[..., None] | None


class _Bar:
    def __init__(self, task: str, total: float | None) -> None:
        try:
            from tqdm.auto import tqdm
        except ImportError:
            self._bar = None
        else:
            self._bar = tqdm(total=total, desc=task, leave=False, bar_format=None if total else "{desc} {postfix}")

    def beats(self, beats: int, distance: float) -> None:
        if self._bar is not None:
            self._bar.set_postfix_str(f"beat {beats}, distance {distance:.1e}")

    def share(self, share: float) -> None:
        if self._bar is not None:
            self._bar.n = share
            self._bar.refresh()

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()


class showing:
    """Context of one call: `.beats` and `.share` are what the compiled part calls (None: nothing)."""

    def __init__(self, progress: Progress, task: str, total: float | None = None) -> None:
        if not (progress is None or isinstance(progress, bool) or callable(progress)):
            raise InputError(f"progress = {shown(progress)}: wanted is True, False, None or a function")
        self._bar = _Bar(task, total) if progress is True else None
        given: Any = progress if callable(progress) else None
        self.beats = self._bar.beats if self._bar else given
        self.share = self._bar.share if self._bar else given

    def __enter__(self) -> showing:
        return self

    def __exit__(self, *exception: object) -> None:
        if self._bar:
            self._bar.close()
