"""Foundations without physics: errors, files, disk cache, memory, progress, threads, compilation."""
