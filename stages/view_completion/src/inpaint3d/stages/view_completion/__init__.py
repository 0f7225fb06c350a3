"""Reconstruction outside the mask, distilled prior inside."""
