"""Global optimisation of thin-film stacks."""
