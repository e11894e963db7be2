"""Writers of height fields for manufacture: GDS layouts, 16-bit grey images, STL solids; and layouts read back."""
