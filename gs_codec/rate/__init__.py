"""Rate targets: find the step sizes and the pruning that give a size or a loss."""
