"""Pictures of a `gf_usd.scene.Scene`, drawn on a CPU without GL."""
