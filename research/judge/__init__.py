"""The judge of controllers: robots, draws and scoring that were fixed first, on a plant by other hands."""
