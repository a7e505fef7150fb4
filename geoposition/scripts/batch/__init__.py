"""Many scenes: a plan read from a file, run by local processes or a Dask cluster, resumable."""
