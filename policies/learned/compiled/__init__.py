"""The fused DQN: whole steps of play and learning as compiled code, where they apply."""
