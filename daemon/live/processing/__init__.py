"""Pairs and sets become clouds: the worker, its load shedding and temporal prior."""
