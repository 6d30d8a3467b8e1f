"""The final report: JSON for programs, HTML for people."""
