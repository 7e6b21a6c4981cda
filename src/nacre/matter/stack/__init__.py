"""Stratified media: what a plane wave does at any number of layers."""
