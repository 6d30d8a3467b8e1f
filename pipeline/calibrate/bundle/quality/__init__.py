"""How good a solution is: errors, coverage of the views, observability, advice."""
