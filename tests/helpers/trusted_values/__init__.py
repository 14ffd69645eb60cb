"""The trusted values of the hard cases, computed in many digits; the package has the table of them alone."""
