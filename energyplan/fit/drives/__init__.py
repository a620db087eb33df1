"""Drives as regression data: speeds freed of noise, delays, columns of terms, windows."""
