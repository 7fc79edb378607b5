"""The client's document: what was found, where it lies and how it looks, and nothing of how it was computed.

records ──► survey ──► album, mosaic ──► sitemap, objects ──► document
                       pictures          SVG and HTML         one file
"""
