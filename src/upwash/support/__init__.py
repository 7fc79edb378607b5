"""What every room may use: no subject of drones, no state, and nothing of upwash but its errors.

    input_files, output_files    files that people name, with bounds; files that are written whole or not at all
    standard_streams             standard output that may be closed, full or a pipe without a reader
    text, sentences, lines       text made fit for logs, terminals and shells
    background                   tasks and threads whose failure is never lost
    loading                      imports by name, and of optional packages
    addresses, http              sockets that listen, requests that mean this machine; servers with bounds
    camera_source, exif          cameras' sources without passwords; the place in a photo
    jpeg, png                    a photo's segments or chunks
    confidence, heat             means with margins; the model of a computer that gets hot

`text`, `background` and `loading` are imported by each service's process: they import nothing heavy. Ugly is that the
last two lines of the table are subjects of their own, which too many rooms need for one of them to own them.
"""
