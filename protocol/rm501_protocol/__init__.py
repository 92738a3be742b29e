"""Part of rm501."""
