"""Making a scene smaller before it is coded: pruning, and refitting what is left."""
