"""The functions of `import gf_usd`, one file each; other programs call these."""
