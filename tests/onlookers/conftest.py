"""The browser of the viewer's tests."""

from tests.view.conftest import browser, look

__all__ = ["browser", "look"]
