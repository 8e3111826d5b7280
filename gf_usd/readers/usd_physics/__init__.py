"""Reader of UsdPhysics: bodies, materials, colliders, attachments, collision filters, gravity."""
