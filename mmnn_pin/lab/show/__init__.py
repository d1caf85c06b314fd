"""What people look at: plots of recordings."""
