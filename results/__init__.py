"""Claims, the JSON files that support them, and the pages generated from both.

`make results` writes the pages.
"""
