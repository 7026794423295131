"""What people look at: drawings, figures, pages."""
