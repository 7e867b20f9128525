"""What is open until it is closed, as context managers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Self


class Closing(ABC):
    """A context manager that closes itself at the end of the block, however the block ends."""

    __slots__ = ()

    @abstractmethod
    def close(self) -> None:
        """Release what is held; a second time there is nothing to do."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
