"""Stratified media: plane waves in stacks with any number of layers."""
