// Offers the tissue to scenes as one more kind of wall.
#pragma once

namespace wiggers {

void register_tissue();

}  // namespace wiggers
