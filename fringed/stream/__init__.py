"""Subscriptions to the clouds of a daemon."""
