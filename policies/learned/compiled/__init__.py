"""The fused DQN: compiled code for the processor, the fast path where it applies."""
