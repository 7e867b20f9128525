"""What is in a recording, and what would go wrong with it."""

from fieldgrid.inspection.findings import Finding, Severity
from fieldgrid.inspection.inspector import inspect_recording
from fieldgrid.inspection.report import Inspection

__all__ = ["Finding", "Inspection", "Severity", "inspect_recording"]
