"""Camera guidance: sensitivities as step sizes; rate targets."""
