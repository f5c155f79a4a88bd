"""Images from poses: colour, metric depth, instance ids, modal and amodal masks, occlusion."""
