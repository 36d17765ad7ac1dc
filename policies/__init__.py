"""What plays and routes on :mod:`marouting`: classical and learned routers, and what runs them."""
