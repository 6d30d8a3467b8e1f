"""The measuring service: composes drivers, pipeline and the public stream."""
