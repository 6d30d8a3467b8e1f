"""The report of a calibration: one HTML file that needs nothing else, neither scripts nor other files."""

from daemon.calibrate.report.build import Report, report_html

__all__ = ["Report", "report_html"]
