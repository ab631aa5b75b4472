// SPDX-License-Identifier: Apache-2.0
// Preloaded into a participant of Fast DDS 2.9 or 3, it presents another permissions document to its peers than that of its
// enclave: the file KEYMINT_PRESENTED.

#include <cstdlib>
#include <fstream>
#include <iterator>
#include <string>

#include <dlfcn.h>

#if __has_include(<fastdds/config.hpp>)
#include <fastdds/rtps/common/Token.hpp>
using eprosima::fastdds::rtps::DataHolder;
#define LIBRARY "7fastdds"
#else
#include <fastdds/rtps/common/Token.h>
using eprosima::fastrtps::rtps::DataHolder;
#define LIBRARY "8fastrtps"
#endif

#define NAME "_ZN8eprosima" LIBRARY "4rtps8security11Permissions32get_permissions_credential_token"                      \
             "EPPNS1_10DataHolderERKNS2_6HandleERNS2_17SecurityExceptionE"

bool present(void*, DataHolder**, const void*, void*) __asm__(NAME);

bool present(void* plugin, DataHolder** token, const void* handle, void* exception)
{
    using Function = bool (*)(void*, DataHolder**, const void*, void*);
    const Function vendors = reinterpret_cast<Function>(dlsym(RTLD_NEXT, NAME));
    std::ifstream file(std::getenv("KEYMINT_PRESENTED"), std::ios::binary);
    const std::string content((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
    if (vendors == nullptr || content.empty())
        std::abort();
    if (!vendors(plugin, token, handle, exception))
        return false;
    for (auto& property : (*token)->properties())
        if (property.name() == "dds.perm.cert")
        {
            property.value(content);
            return true;
        }
    std::abort();
}
