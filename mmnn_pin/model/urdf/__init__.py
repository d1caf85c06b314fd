"""A URDF read: audited before a loader could guess, drop or crash; links, joints, and its geometry at rest."""
