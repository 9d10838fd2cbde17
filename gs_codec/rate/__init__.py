"""Rate targets: the step sizes and pruning that give a size or a loss."""
