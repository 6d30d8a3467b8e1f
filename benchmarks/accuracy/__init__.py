"""Accuracy of clouds against the simulator's truth, by case, disturbing effect and mode; fit of the border test."""
