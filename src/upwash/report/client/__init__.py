"""The client's document: what was found, where it lies and how it looks, and nothing of how it was computed.

flights ──► survey      flights, photos, and objects with the sightings that show each best
            album       their pictures, scaled, within a bound on all together
            mosaic      the photos laid over the ground
            sitemap     the mosaic under numbered objects
            words       the client's own words for labels
            document    all of it as one HTML file
"""
