"""Stratified media: plane waves in stacks with any layer count."""
