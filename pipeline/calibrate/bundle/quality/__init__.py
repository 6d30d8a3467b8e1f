"""Quality of a solution: errors, coverage of the views, observability, missing views."""
