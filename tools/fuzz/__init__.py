"""Broken and random inputs by the thousand: `make fuzz`. Each gives an answer that can be, or one clear line."""
