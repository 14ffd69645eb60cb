"""The dossier: every experiment run or reused, and the site of all claims."""
