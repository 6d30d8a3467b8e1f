"""One module a command, each with a function ``main`` (or a typer app ``app``), imported when it is named."""
