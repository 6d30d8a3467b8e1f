"""Tables of rays and views, and triangulation."""
