"""What a recorder on a site does beside writing: tell of its seals, and decide what may be written.

`SealPublisher` tells witnesses of each seal, `PictureFetcher` gets what the bin saw, `MessageDoor` and
`StatementListener` keep out what would spoil a recording, `Refusals` counts it, and `copies` keeps what
others recorded. The file itself is written by `rodeo.evidence`.
"""
