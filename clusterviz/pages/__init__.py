"""Self-contained HTML pages of measurements of a scene, with their numbers as JSON: from measure to charts to page."""
