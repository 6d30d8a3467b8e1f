"""The drivers' protocols on rendered images: options, faults, triggers."""
