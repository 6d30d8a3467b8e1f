/* Calls of GenTL 1.6. This producer is one of version 1.5; some programs complain on standard output where they do not
 * even find them, so they are there and answer what the standard says of functions that are not implemented. */
#include "producer.h"

#define ANSWERS_NO(name) \
    API GC_ERROR name(void); \
    API GC_ERROR name(void) { return fail(GC_ERR_NOT_IMPLEMENTED, #name " belongs to GenTL 1.6"); }

ANSWERS_NO(DSAnnounceCompositeBuffer)
ANSWERS_NO(DSGetBufferInfoStacked)
ANSWERS_NO(DSGetBufferPartInfoStacked)
ANSWERS_NO(DSGetBufferSegmentInfo)
ANSWERS_NO(DSGetFlowInfo)
ANSWERS_NO(DSGetNumBufferSegments)
ANSWERS_NO(DSGetNumFlows)
