/* Functions of GenTL 1.6. This producer implements version 1.5; some programs warn about missing functions, so these
 * exist and return the standard's code for functions that are not implemented. */
#include "producer.h"

#define NOT_IMPLEMENTED(name) \
    API GC_ERROR name(void); \
    API GC_ERROR name(void) { return fail(GC_ERR_NOT_IMPLEMENTED, #name " belongs to GenTL 1.6"); }

NOT_IMPLEMENTED(DSAnnounceCompositeBuffer)
NOT_IMPLEMENTED(DSGetBufferInfoStacked)
NOT_IMPLEMENTED(DSGetBufferPartInfoStacked)
NOT_IMPLEMENTED(DSGetBufferSegmentInfo)
NOT_IMPLEMENTED(DSGetFlowInfo)
NOT_IMPLEMENTED(DSGetNumBufferSegments)
NOT_IMPLEMENTED(DSGetNumFlows)
