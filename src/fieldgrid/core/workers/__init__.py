"""Work on several cores, and on the workers of a Dask cluster."""
