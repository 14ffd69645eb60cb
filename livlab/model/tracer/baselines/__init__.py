"""Appearance models to compare with: Lambert, Blinn–Phong, the dipole, Ashikhmin–Shirley."""
