"""Run tasks in this process, a pool of processes, or a Dask cluster, behind one interface."""
