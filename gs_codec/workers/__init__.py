"""What does tasks: this process, a pool of processes, or a Dask cluster, behind one interface."""
