"""Margins of fringe orders: how clearly the orders of a surface win against others."""
