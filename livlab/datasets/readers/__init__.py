"""Files of spectra: one reader a file format, one table of readers."""
