"""The test set: vibro-impact problems with known answers, and the score of an integrator on them."""
