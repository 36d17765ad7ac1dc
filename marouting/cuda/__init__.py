"""Games on a CUDA device, for ``BatchEnv(…, device="cuda")``."""
