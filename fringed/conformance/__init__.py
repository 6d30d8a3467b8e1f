"""Conformance kit: recorded streams, a server that replays them, and a check of what a client made of them.

``python -m fringed.conformance serve`` listens; the client under test writes what it received as lines of JSON;
``python -m fringed.conformance check RESULTS`` compares them with the expected ones.
"""
