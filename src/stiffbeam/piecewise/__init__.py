"""Linear systems that change at events: regimes, the search for the next event, motions and what is read of them."""
