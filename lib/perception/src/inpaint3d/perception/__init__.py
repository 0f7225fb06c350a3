"""What a pretrained network sees in pictures: LPIPS, and matching of its features."""
