"""Where a cart is, against other filters, shapely and drives whose truth is known."""
