"""The wheels of both distributions."""
