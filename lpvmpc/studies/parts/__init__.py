"""What several figures of one study share."""
