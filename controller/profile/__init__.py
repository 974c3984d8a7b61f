"""Speed profiles: how a train should run from stop to stop, and where on it the train is now."""

from controller.profile.profile import ProfileError, SpeedProfile

__all__ = ["ProfileError", "SpeedProfile"]
