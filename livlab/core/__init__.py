"""Files and kernels: reading with limits, writing whole, NetCDF, TOML, markup, compiled code."""
